"""Dependencies, studies and benchmarks: versions agree, programs start, and studies judge known answers."""

import importlib
import tomllib
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from geort_drake.hands.hand import Hand
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

ROOT = Path(__file__).resolve().parents[1]
# They judge the sources or build the site.
TOOLS = {
    "build",
    "cogapp",
    "mypy",
    "ruff",
    "twine",
    "mkdocs",
    "mkdocs-material",
    "mkdocstrings",
    "latex2mathml",
}


def ranges() -> dict[str, Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = [text for extra in project["optional-dependencies"].values() for text in extra]
    wanted = [Requirement(text) for text in project["dependencies"] + extras]
    return {canonicalize_name(item.name): item for item in wanted if item.name != project["name"]}


def pins(file: str) -> dict[str, Version]:
    lines = (ROOT / file).read_text("utf-8").splitlines()
    pairs = [line.split("==") for line in lines if not line.startswith("#")]
    return {canonicalize_name(name): Version(version) for name, version in pairs}


def test_the_oldest_versions_are_the_lower_bounds():
    """Each dependency has one, and it is what `make test-lowest` installs."""
    bounds = {
        name: next(Version(part.version) for part in item.specifier if part.operator in (">=", "=="))
        for name, item in ranges().items()
        if name not in TOOLS
    }
    assert pins("constraints-lowest.txt") == bounds


@pytest.mark.parametrize("name", ranges())
def test_the_newest_version_is_within_the_range(name):
    """Each dependency has one, and it is what `make test` installs."""
    assert pins("constraints.txt")[name] in ranges()[name].specifier


STUDIES = {path.stem for path in (ROOT / "studies").glob("*.py")} - {"worsened"}
BENCHMARKS = {path.stem for path in (ROOT / "benchmarks").glob("bench_*.py")}
PROGRAMS = [*(f"studies.{name}" for name in STUDIES), *(f"benchmarks.{name}" for name in BENCHMARKS)]


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_a_program_starts_and_explains_itself(program, capsys, monkeypatch):
    """Everything it imports exists, and its help names its options."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    monkeypatch.syspath_prepend(ROOT / "studies")
    with pytest.raises(SystemExit) as stopped:
        importlib.import_module(program).main(["--help"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out.startswith("usage:")


def test_every_picture_of_the_docs_can_be_made_anew(monkeypatch):
    """By studies, but for drawings; and it is small enough to load at once."""
    monkeypatch.syspath_prepend(ROOT / "studies")
    pictures = importlib.import_module("studies.pictures")
    for image in (ROOT / "docs" / "images").iterdir():
        made = image.suffix == ".svg" or image.stem in {*pictures.PICTURES, *STUDIES, "live_film"} | {
            study.removeprefix("draw_") for study in STUDIES
        }
        assert made, f"{image} cannot be made anew"
        assert image.stat().st_size < (1_500_000 if image.suffix == ".webp" else 300_000)


def test_gates_tell_a_right_order_from_chance_and_from_a_reversed_one():
    """Ties count for neither."""
    ordering = importlib.import_module("studies.gates").ordering
    tau, p = ordering(np.tile([1.0, 1.0, 0.8, 0.2], (4, 1)))
    assert tau == pytest.approx(5 / 6, abs=1e-3) and p < 0.01
    tau, p = ordering(np.tile([0.2, 0.5, 0.8, 1.0], (4, 1)))
    assert tau == -1 and p > 0.99
    tau, p = ordering(np.ones((4, 4)))
    assert tau == 0 and p == 1


def test_a_task_speaks_for_people_to_whom_it_reveals_a_fault_of_two_families():
    """Here, shrinking spoils two maps, and turning another map of which it is the only fault."""
    gates = importlib.import_module("studies.gates")
    spoiled = {("affine_ik", "shrunk"), ("geort", "shrunk"), ("universal", "turned")}

    def row_of(key):
        fault, _, size = key.condition.partition("=")
        spoils = (key.method, fault) in spoiled and (key.kind == "adaptive" or key.method == "geort")
        score = 1.0 - gates.SIZES[fault].index(float(size)) / 3 if spoils else 1.0
        result = {"success": key.method != "hold", "score": score, "completion_time": 9.0, "outcome": ""}
        return {**key._asdict(), **result, "timeout": 30.0}

    log, keys = {}, gates.scripted_keys(["keys"], 2) + gates.next_keys([], ["keys"], ["adaptive", "servo"], 4)
    while keys:
        log |= {key: row_of(key) for key in keys}
        rows = list(log.values())
        keys = gates.next_keys(rows, ["keys"], ["adaptive", "servo"], 4)
    text = gates.report(rows)
    assert "| keys | 2 of 2 | 0 of 2 |" in text
    assert "| keys | adaptive | shrunk | turned | not tried | yes |" in text
    assert "| keys | servo | none | none | shrunk | no |" in text
    tried = {(row["kind"], row["method"], row["condition"].partition("=")[0]) for row in rows}
    assert {fault for *who, fault in tried if who == ["adaptive", "affine_ik"]} == {"", "shrunk"}
    assert {fault for *who, fault in tried if who == ["adaptive", "universal"]} == {
        "",
        *list(gates.SIZES)[:3],
    }
    assert not any(kind == "adaptive" and family == "geort" for kind, family, _ in tried)
    assert {fault for *who, fault in tried if who == ["servo", "universal"]} == {"", *gates.SIZES}


def test_worsened_maps_mix_turn_shrink_open_or_shake_the_motion_of_fingers():
    worsened = importlib.import_module("worsened")
    rest, moved = np.zeros((4, 3)), np.zeros((4, 3))
    moved[1] = 0.01, 0.0, 0.0  # the index finger, out of the palm

    def echo(p_HF):
        return p_HF

    echo.joint_names = ()

    def answer(fault: str, size: float, rest: np.ndarray = rest, p_HF: np.ndarray = moved) -> np.ndarray:
        return worsened.WorsenedMap(echo, rest, range(4), {fault: size}, 0)(p_HF)

    np.testing.assert_allclose(answer("mixed", 0.5), [[0, 0, 0], moved[1], 0.25 * moved[1], 0.25 * moved[1]])
    turned = answer("turned", 60.0)
    assert turned[1, 0] == pytest.approx(0.005) and np.linalg.norm(turned[1]) == pytest.approx(0.01)
    np.testing.assert_allclose(turned[[0, 2, 3]], 0.0)
    np.testing.assert_allclose(answer("shrunk", 0.75), 0.25 * moved)
    # Fingers 100 mm apart; the second comes to the thumb, the third half-way.
    apart = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    pinch = np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0.04, 0], [0, 0, 0.1]])
    opened = answer("gapped", 20.0, apart, pinch) - pinch
    np.testing.assert_allclose(opened, [[0, 0, 0], [0.02, 0, 0], [0, 0.01, 0], [0, 0, 0]], atol=1e-12)
    shaken = worsened.WorsenedMap(echo, rest, range(4), {"jittering": 2.0}, 0)
    noise = np.array([shaken(moved) - moved for _ in range(500)])
    assert noise.std() == pytest.approx(0.002, rel=0.05)
    shaken.reset()
    np.testing.assert_array_equal(shaken(moved) - moved, noise[0])
    drifting = worsened.WorsenedMap(echo, rest, range(4), {"drifting": 10.0}, 0)
    ways = np.linalg.norm([drifting(moved) - moved for _ in range(2000)], axis=2)
    np.testing.assert_allclose(ways[[499, 999, 1499]], [[0.01] * 4, [0.0] * 4, [0.01] * 4], atol=1e-12)
    # Along the finger's axis, the gain is 0.5 on one side and 1.5 on the other.
    line = np.zeros((200, 4, 3))
    line[:, 1, 0] = np.linspace(-0.15, 0.15, 200)
    uneven = worsened.WorsenedMap(echo, rest, range(4), {"uneven": 3.0}, 0)
    axis = worsened._directions(np.random.default_rng(0), 4)[1]
    steps = np.diff([uneven(p)[1] for p in axis * line[:, :, :1]], axis=0) @ axis / (0.3 / 199)
    assert steps[0] == pytest.approx(0.5, abs=0.01) and steps[-1] == pytest.approx(1.5, abs=0.01)


def test_twisted_maps_turn_distal_links_without_moving_the_fingertips():
    worsened = importlib.import_module("worsened")
    hand = Hand("allegro_right").kinematics()
    solver = NumpyKinematics(hand)
    q = hand.lower + 0.4 * (hand.upper - hand.lower)

    def constant(p_HF):
        return q

    constant.joint_names = hand.joint_names
    twisted = worsened.WorsenedMap(constant, np.zeros((4, 3)), range(4), {"twisted": 0.4}, 0, hand)
    answer = twisted(np.zeros((21, 3)))
    moved = np.linalg.norm(solver.fingertips(answer[None]) - solver.fingertips(q[None]), axis=-1)
    assert moved.max() < 0.0005
    np.testing.assert_allclose(np.linalg.norm((answer - q).reshape(4, 4), axis=1), 0.4, rtol=0.1)


def test_the_calibration_finds_which_number_of_the_person_changes_the_score_and_how_much():
    calibration = importlib.import_module("calibrate_operator")
    design = calibration.design()
    np.testing.assert_array_equal(design.T @ design, 32 * np.eye(16))
    np.testing.assert_array_equal(design[0::2], -design[1::2])
    grip = [names[0] for names in calibration.ASSUMED].index("grip_force")
    rng, rows = np.random.default_rng(0), []
    for key in calibration.keys_of():
        score = 0.6 + 0.1 * design[key.person, grip] - 0.2 * (key.task == "cap") + rng.normal(0.0, 0.05)
        result = {"success": True, "score": score, "completion_time": 9.0, "outcome": ""}
        rows.append({**key._asdict(), **result, "timeout": 30.0})
    table = calibration.effects(calibration.frame_of(rows)).set_index("name")
    name = "grip_force and grip_per_weight"
    assert table["from"][name] < 0.2 < table["to"][name]
    assert list(table.index[table["p_holm"] < 0.05]) == [name]
    assert "**+20 [" in calibration.report(rows)
    # A check compares pairs on maps, objects and seeds that the calibration has not.
    fields = [(key.method, key.condition, key.seed) for key in calibration.keys_of()]
    assert {*fields}.isdisjoint((key.method, key.condition, key.seed) for key in calibration.check_keys(2))


def test_the_study_of_criteria_finds_which_faults_cost_score_and_how_much():
    criteria = importlib.import_module("criteria")
    design = np.array([[2.0 * spoils - 1.0 for spoils in row.values()] for row in criteria.design()])
    np.testing.assert_array_equal(design.T @ design, 16 * np.eye(7))
    np.testing.assert_array_equal(design[0::2], -design[1::2])
    rng, rows = np.random.default_rng(0), []
    for key in criteria.keys_of(["keys"], ["servo"]):
        score = 1.0 - 0.3 * ("turned" in key.condition) + rng.normal(0.0, 0.05)
        result = {"success": True, "score": score, "completion_time": 9.0, "outcome": ""}
        rows.append({**key._asdict(), **result, "timeout": 30.0})
    assert len({(row["condition"], row["seed"]) for row in rows}) == 48
    table = criteria.effects(criteria.frame_of(rows)).set_index("criterion")
    assert table["low"]["direction"] < -0.3 < table["high"]["direction"]
    assert list(table.index[table["p_holm"] < 0.05]) == ["direction"]
    overall = criteria.overall(criteria.frame_of(rows)).set_index("criterion")
    np.testing.assert_allclose(overall["effect"], table["effect"])  # of a single task and kind
