"""The map for everyone: its folded weights, the ways to call it and its file."""

import numpy as np
import pytest
from universal_map import FINGERS, PLAY, random_map, random_retargeter, saved_map

from geort_drake.errors import CheckpointError, GeortError
from geort_drake.retargeting.map_file import load_map
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.retargeting.universal import PINCH_UNIT


def silu(u):
    return u / (1.0 + np.exp(-u))


def by_definition(file, code, p_HF):
    """The map as its network is defined, one hand p_HF (F, 3) at a time."""
    a = {name: array.astype(int if name == "columns" else float) for name, array in file.arrays.items()}
    F, thumb, code = len(p_HF), file.finger_names.index("thumb"), code.astype(float)
    z = np.clip((code - a["code_mean"]) / a["code_deviation"], -3, 3)
    z = silu(silu(z @ a["code_weight0"] + a["code_bias0"]) @ a["code_weight1"] + a["code_bias1"])
    Ab = z @ a["input_weight"] + a["input_bias"]
    A, b = Ab[: 9 * F].reshape(F, 3, 3), Ab[9 * F :].reshape(F, 3)
    g = np.einsum("m,kfmh->kfh", z, a["modulation_weight"]) + a["modulation_bias"]
    gain, offset = np.einsum("m,kmr->kr", z, a["residual_modulation_weight"]) + a["residual_modulation_bias"]
    K, L, mean, spread = np.split(code[: 8 * F], np.array([3, 4, 7]) * F)
    x = ((p_HF - K.reshape(F, 3)) / L[:, None] - mean.reshape(F, 3)) / spread[:, None]
    x = x + np.einsum("fi,fij->fj", x, A) + b
    d = [(p_HF[thumb] - p) / PINCH_UNIT for j, p in enumerate(p_HF) if j != thumb]
    y = []
    for f in range(F):
        u = silu((x[f] @ a["weight0"][f] + a["bias0"][f, 0]) * (1 + g[0, f]) + g[1, f])
        u = silu((u @ a["weight1"][f] + a["bias1"][f, 0]) * (1 + g[2, f]) + g[3, f])
        y.append(u @ a["weight2"][f] + a["bias2"][f, 0])
    u = np.concatenate([x.ravel(), np.ravel(d)]) @ a["residual_weight0"] + a["residual_bias0"]
    u = silu(silu(u * (1 + gain) + offset) @ a["residual_weight1"] + a["residual_bias1"])
    y = (np.concatenate(y) + u @ a["residual_weight2"] + a["residual_bias2"])[a["columns"]]
    lower, upper = np.array(file.lower), np.array(file.upper)
    return 0.5 * (lower + upper) + 0.5 * (upper - lower) * np.tanh(y)


@pytest.mark.parametrize("fingers", [("index", "thumb"), FINGERS, (*FINGERS, "little")])
def test_a_persons_map_is_the_network_with_their_code(fingers):
    """Folding the person into the weights changes nothing, for the average person and for an odd one."""
    file = random_map(joints=7, fingers=fingers)
    retarget = random_retargeter(joints=7, fingers=fingers)
    for frames in (PLAY, 1.3 * PLAY[:5]):
        code = retarget.code(frames)
        own = retarget.for_person(frames)
        for p_HK in frames[::251]:
            wanted = by_definition(file, code, p_HK[list(file.human_keypoints)])
            np.testing.assert_allclose(own(p_HK), wanted, atol=1e-9)


def test_it_works_at_once_and_as_one_persons_map():
    """A call takes the shape from its frames; a person's map also takes fingertips and has a Jacobian."""
    retarget = random_retargeter()
    own = retarget.for_person(PLAY)
    np.testing.assert_allclose(retarget(PLAY), own(PLAY))
    np.testing.assert_allclose(retarget(PLAY[0]), retarget(PLAY[:1])[0])
    tips = PLAY[0, list(retarget.human_keypoints)]
    np.testing.assert_allclose(own(tips), own(PLAY[0]))
    assert own.jacobian(tips).shape == (16, 4, 3)
    assert own.trained_space.distances(PLAY[7]).max() < 0.01
    compiled = random_retargeter(backend="numba").for_person(PLAY)
    np.testing.assert_allclose(compiled(tips), own(tips), atol=1e-9)


def test_it_refuses_what_shows_no_person():
    """Fingertips alone, no frames, NaN, and points without a hand."""
    retarget = random_retargeter()
    with pytest.raises(ValueError, match="for_person"):
        retarget(PLAY[0, :4])
    for call, frames in ((retarget, PLAY[:0]), (retarget.for_person, PLAY[0])):
        with pytest.raises(ValueError, match="whole hands"):
            call(frames)
    for frame, message in ((np.full((21, 3), np.nan), "finite"), (np.zeros((21, 3)), "length is zero")):
        with pytest.raises(GeortError, match=message):
            retarget(frame)


def test_a_person_unlike_all_others_is_clamped_and_named():
    """The part farthest out is said, and how far."""
    retarget = random_retargeter()
    code = retarget.code(PLAY)
    assert retarget.unusual(code) == ""
    odd = code.copy()
    odd[len(FINGERS) * 3 + 1] *= 10.0  # the index finger's length
    assert retarget.unusual(odd).startswith("length of the index: ")
    assert np.isfinite(retarget.folded(odd)(PLAY)).all()


def test_a_file_gives_the_map_back(tmp_path):
    """In single precision, with the names of its hands; a shipped name lists the choices when unknown."""
    path = saved_map(tmp_path / "map.safetensors")
    np.testing.assert_allclose(load_retargeter(path)(PLAY), random_retargeter()(PLAY), atol=1e-5)
    assert load_map(path).hands == {"some_hand": "0"}
    with pytest.raises(CheckpointError, match=r"no such checkpoint.*shipped"):
        load_retargeter("allegro_middle")


def test_a_file_that_is_no_map_is_refused(tmp_path):
    """Damaged, of another format, or without an array."""
    path = saved_map(tmp_path / "map.safetensors")
    whole = path.read_bytes()
    for contents, message in (
        (whole[:-9], "not a safetensors file"),
        (whole.replace(b'"format":"1"', b'"format":"7"'), "format is 7"),
        (whole.replace(b"code_bias0", b"code_biasX"), "'code_bias0' is missing"),
        (whole.replace(b'\\"thumb\\"', b'\\"thing\\"'), "unknown 'thing'"),
    ):
        path.write_bytes(contents)
        with pytest.raises(CheckpointError, match=message):
            load_retargeter(path)
