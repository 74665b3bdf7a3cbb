"""Messages from the page, as specified in docs/reference/web-protocol.md."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from geort_drake.live.messages import Keypoints, Point, Side
from geort_drake.live.transports import decode_json
from geort_drake.people.formats import NODE_COUNT
from geort_drake.people.keypoints import KEYPOINT_COUNT

VERSION = 1
MAX_BYTES = 16_384  # a longer message ends the connection

# A landmark outside the picture is extrapolated, and thus near it.
PicturePoint = tuple[Annotated[float, Meta(ge=-10.0, le=10.0)], Annotated[float, Meta(ge=-10.0, le=10.0)]]
Seconds = Annotated[float, Meta(ge=0.0, le=1e9)]
Picture = Annotated[list[PicturePoint], Meta(min_length=KEYPOINT_COUNT, max_length=KEYPOINT_COUNT)]
Joints = Annotated[list[Point], Meta(min_length=NODE_COUNT, max_length=NODE_COUNT)]


class Message(msgspec.Struct, forbid_unknown_fields=True, tag_field="type", tag=str.lower):
    """A message from the page."""


class Hello(Message):
    """Introduces a page and its hand; `hand_length` is from wrist to middle fingertip, m."""

    version: Literal[1]
    role: Literal["operator", "spectator"]
    device: Literal["camera", "headset", "scripted", "pointer", "recording", "simulated"]
    side: Side
    hand_length: Annotated[float, Meta(ge=0.1, le=0.3)] | None = None


class Camera(Message):
    """MediaPipe's landmarks at time `t`, s: world, m, and picture, as fractions of width and height."""

    t: Seconds
    world: Keypoints
    image: Picture
    aspect: Annotated[float, Meta(ge=0.2, le=5.0)]
    score: Annotated[float, Meta(ge=0.0, le=1.0)] = 1.0


class Headset(Message):
    """Positions of WebXR's joints at time `t`, s, in a local-floor space, m."""

    t: Seconds
    joints: Joints


Share = Annotated[float, Meta(ge=-1.0, le=1.0)]


class Pointer(Message):
    """The mouse at time `t`, s: right `x`, down `y` and forward `z`, as shares of the view; and the grip."""

    t: Seconds
    x: Share
    y: Share
    z: Share
    grip: Literal["index", "middle", "ring", "little", "hand"]
    closed: bool


class Lost(Message):
    """No hand is seen at time `t`, s."""

    t: Seconds


class Engage(Message):
    """Asks the robot to follow."""


class Disengage(Message):
    """Asks the robot to brake and hold."""


Name = Annotated[str, Meta(max_length=64)]


class Reset(Message):
    """Restarts the scene, with another robot hand, mount, task or object where one is named."""

    hand: Name | None = None
    mount: Name | None = None
    task: Name | None = None
    object: Name | None = None


class Record(Message):
    """Records sessions from the next engagement on; the person consents that recordings are kept."""

    keep: Literal[True]


class Stop(Message):
    """Ends the recording and withdraws the consent to further ones."""


class Fist:
    """A held fist, which toggles engagement. No page sends it; the station detects it."""


Request = Engage | Disengage | Reset | Record | Stop
Command = Request | Fist
Hand = Camera | Headset | Pointer | Lost
_DECODER = msgspec.json.Decoder(Hello | Hand | Request)


def decode(text: str | bytes) -> Hello | Hand | Request:
    """Returns the message in a text.

    Raises:
        LiveError: the message is too long or malformed; the error names the field.
    """
    return decode_json(_DECODER, text, "message")
