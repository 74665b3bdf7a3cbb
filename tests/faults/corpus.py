"""Every malformed input that there is."""

from faults import bad_checkpoints, bad_commands, bad_hands, bad_messages, bad_recordings, bad_scenarios
from faults.refusals import Case

_MODULES = (bad_recordings, bad_checkpoints, bad_scenarios, bad_hands, bad_commands, bad_messages)
CASES: list[Case] = [case for module in _MODULES for case in module.CASES]
