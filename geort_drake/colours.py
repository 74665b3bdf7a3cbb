"""Colours with one meaning in all plots and recordings."""

Color = tuple[int, ...]  # red, green, blue and optional opacity, 0–255

# Five of Okabe and Ito's, which colour-blind readers can tell apart, and which are read on white and on dark
# backgrounds. Red and bright green are left for what is wrong or right.
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
