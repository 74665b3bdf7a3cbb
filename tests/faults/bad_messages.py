"""Messages of gloves that no live loop may follow: those of test_live_messages.py."""

from test_live_messages import REFUSED

from faults.refusals import Case
from geort_drake.live.messages import decode

CASES = [
    Case(
        "message",
        name,
        lambda _folder, message=message: (decode, message, "right"),
        "LiveError|MismatchError",
        told,
    )
    for name, (message, told) in REFUSED.items()
]
