"""A small map for everyone with random weights, shared by the tests."""

from pathlib import Path

import numpy as np

from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.map_file import MapFile
from geort_drake.retargeting.person_code import CODE_SIZE, AveragePerson, observe
from geort_drake.retargeting.universal import UniversalRetargeter

FINGERS = ("thumb", "index", "middle", "ring")
PLAY = synthesize_play(seed=1, duration_s=20.0, rate_hz=60.0).p_HK.astype(float)


def random_map(joints: int = 16, seed: int = 0, fingers: tuple[str, ...] = FINGERS) -> MapFile:
    """A map whose weights are random, for a person like that of `PLAY`."""
    rng = np.random.default_rng(seed)
    F, h, r, m = len(fingers), 8, 12, 10
    k = -(-joints // F)
    seen = observe(PLAY, fingers)
    person = AveragePerson(seen.mean, seen.scatter / seen.places[:, None, None], 20.0, 40.0)
    sizes = {
        "code_weight0": (CODE_SIZE * F, m), "code_bias0": (m,), "code_weight1": (m, m), "code_bias1": (m,),
        "input_weight": (m, 12 * F), "input_bias": (12 * F,),
        "modulation_weight": (4, F, m, h), "modulation_bias": (4, F, h),
        "residual_modulation_weight": (2, m, r), "residual_modulation_bias": (2, r),
        "weight0": (F, 3, h), "bias0": (F, 1, h), "weight1": (F, h, h), "bias1": (F, 1, h),
        "weight2": (F, h, k), "bias2": (F, 1, k), "residual_weight0": (6 * F - 3, r), "residual_bias0": (r,),
        "residual_weight1": (r, r), "residual_bias1": (r,), "residual_weight2": (r, F * k),
        "residual_bias2": (F * k,),
    }  # fmt: skip
    arrays = {name: 0.3 * rng.normal(size=size).astype(np.float32) for name, size in sizes.items()}
    code = person.code(seen)
    arrays |= person.arrays() | {"code_mean": code, "code_deviation": 0.05 + 0.1 * np.abs(code)}
    arrays["columns"] = rng.permutation(F * k)[:joints]
    names = tuple(f"joint_{j}" for j in range(joints))
    return MapFile(
        arrays,
        {"some_hand": "0"},
        fingers,
        names,
        [TIP_KEYPOINT[name] for name in fingers],
        [-0.5] * joints,
        [1.5] * joints,
        {},
        {},
    )


def random_retargeter(backend: str = "numpy", **options) -> UniversalRetargeter:
    """The retargeter of `random_map`."""
    file = random_map(**options)
    return UniversalRetargeter(
        file.arrays,
        file.finger_names,
        file.joint_names,
        file.human_keypoints,
        file.lower,
        file.upper,
        backend,
    )


def saved_map(path: Path, **options) -> Path:
    """The file of `random_map`."""
    random_map(**options).save(path)
    return path
