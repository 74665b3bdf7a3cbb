"""Colours with one meaning in all plots and recordings."""

from collections.abc import Iterable

Color = tuple[int, ...]  # red, green, blue and optional opacity, 0–255

# From the palette of Okabe and Ito, which colour-blind readers can tell apart, on light and dark backgrounds.
# Red and bright green are reserved for wrong and right.
FINGER_COLOURS = {
    "thumb": "#E69F00",
    "index": "#56B4E9",
    "middle": "#009E73",
    "ring": "#CC79A7",
    "little": "#0072B2",
}
SKIN: Color = (224, 172, 138)


def rgb(colour: str) -> Color:
    """Red, green, blue of "#RRGGBB"."""
    return tuple(bytes.fromhex(colour.removeprefix("#")))


def finger_colors(names: Iterable[str]) -> list[Color]:
    """Red, green, blue of each finger."""
    return [rgb(FINGER_COLOURS[name]) for name in names]
