"""Makes retargeters by method name; trains those that the cache lacks."""

from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.comparison.train import cached_checkpoint
from geort_drake.hands.description import load_hand
from geort_drake.hands.mirror import canonical_kinematics
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.method import Retarget
from geort_drake.retargeting.methods import (
    make_untrained,
    shipped_methods,
    trained_methods,
    untrained_methods,
)
from geort_drake.retargeting.retargeter import load_retargeter, shipped_map

if TYPE_CHECKING:
    from geort_drake.people.recording import Recording


def retargeter_of(
    method: str, hand_name: str, recording: "Recording", seed: int, device: str = "cpu"
) -> tuple[Retarget, Path | None, bool]:
    """The retargeter of a checkpoint or map, or of a method, trained on the recording if it learns.

    Returns:
        The retargeter; its checkpoint or map, None if the method has none; and whether it existed before.
    """
    hand = HandModel(load_hand(hand_name))
    if method in untrained_methods():
        keypoints = hand.description.human_keypoints
        frames = recording.fingertips(keypoints)
        kinematics = canonical_kinematics(hand)
        return make_untrained(method, kinematics, keypoints, frames=frames, seed=seed), None, True
    path, reused = Path(method), True
    if method in shipped_methods():
        path = shipped_map(hand)
    if method in trained_methods():
        path, reused = cached_checkpoint(hand_name, recording, method, seed, device)
    return load_retargeter(path, hand), path, reused
