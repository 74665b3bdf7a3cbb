"""Which of the known forms a glove's message has, and the frame in it."""

from geort_drake.errors import LiveError, MismatchError
from geort_drake.live.glove_frame import FORMAT, MAX_BYTES, GloveFrame, decode_frame, parse_json
from geort_drake.live.manus_bridge import decode_manus_glove, decode_text


def decode(message: bytes, side: str, glove_id: str | None = None) -> GloveFrame | None:
    """The frame in a message of any known form, or None where the message is about another glove.

    Args:
        side: of the wanted hand.
        glove_id: serial number of the wanted MANUS glove, where there are several.

    Raises:
        MismatchError: another version, unit or hand; see `decode_frame` and `decode_text`.
        LiveError: the message is too long or malformed.
    """
    if len(message) > MAX_BYTES:
        raise LiveError(f"glove message: {len(message)} bytes; at most {MAX_BYTES} are read")
    if not message.lstrip().startswith(b"{"):
        return decode_text(message, side, glove_id)
    fields = parse_json(message)
    if fields.get("format") == FORMAT:
        frame: GloveFrame | None = decode_frame(fields)
    elif "raw_nodes" in fields:
        frame = decode_manus_glove(fields, glove_id)
    else:
        raise LiveError(f"glove message: neither of format {FORMAT} nor a ManusGlove with raw_nodes")
    if frame is not None and frame.side != side:
        raise MismatchError(f"glove message: a {frame.side} hand is sent, the robot's is a {side} one")
    return frame
