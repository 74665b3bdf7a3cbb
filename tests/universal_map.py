"""A universal map with random weights, shared by the tests."""

from collections.abc import Sequence

import torch
from retargeting_toy import toy_kinematics

from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.map_file import MapFile
from geort_drake.retargeting.methods.coupled.universal_network import UniversalNetwork
from geort_drake.retargeting.person_code import AveragePerson, observe
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.universal import UniversalRetargeter

FINGERS = ("thumb", "index", "middle", "ring")
PLAY = synthesize_play(seed=1, duration_s=20.0, rate_hz=60.0).p_HK.astype(float)


def average_person(fingers: Sequence[str] = FINGERS) -> AveragePerson:
    """One like that of `PLAY`."""
    seen = observe(PLAY, fingers)
    return AveragePerson(seen.mean, seen.scatter / seen.places[:, None, None], 20.0, 40.0)


def random_network(fingers: Sequence[str] = FINGERS, hand: HandKinematics | None = None) -> UniversalNetwork:
    """A network with random weights for people like that of `PLAY`, in double precision.

    It is for a toy hand by default.
    """
    generator = torch.Generator().manual_seed(0)
    code = torch.tensor(average_person(fingers).code(observe(PLAY, fingers))).double()
    codes = code * (1.0 + 0.05 * torch.randn(50, len(code), generator=generator))
    thumb = list(fingers).index("thumb")
    pairs = [(thumb, other) for other in range(len(fingers)) if other != thumb]
    x = torch.randn(50, len(fingers), 3, generator=generator)
    network = UniversalNetwork(hand or toy_kinematics(fingers), codes, x, pairs, generator)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.05 * torch.randn(parameter.shape, generator=generator))
    return network.float().double()


def map_of(network: UniversalNetwork, fingers: Sequence[str] = FINGERS) -> MapFile:
    """The file of a network."""
    hand = toy_kinematics(fingers)
    keypoints = [TIP_KEYPOINT[name] for name in fingers]
    arrays = network.arrays() | average_person(fingers).arrays()
    names = list(hand.joint_names)
    return MapFile(arrays, {"toy": "0"}, fingers, names, keypoints, hand.lower, hand.upper, {}, {})


def retargeter_of(file: MapFile, backend: str = "numpy") -> UniversalRetargeter:
    """The retargeter of a file."""
    names = file.finger_names, file.joint_names, file.human_keypoints
    return UniversalRetargeter(file.arrays, *names, file.lower, file.upper, backend)


def random_retargeter(backend: str = "numpy") -> UniversalRetargeter:
    """The retargeter of a random network."""
    return retargeter_of(map_of(random_network()), backend)
