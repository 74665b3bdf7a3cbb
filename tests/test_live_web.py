"""The live page's station: what it reads, who may speak, and that nothing said there harms the loop."""

import json

import numpy as np
import pytest
from faults.mutations import changed, mutated
from live_messages import PLAY, R_CW, camera, headset, hello, in_world, known, station
from loop_bench import LoopBench

from geort_drake import load_hand
from geort_drake.errors import GeortError, LiveError, MismatchError
from geort_drake.live.glove_stream import HANDSHAKE_FRAMES
from geort_drake.live.web.hands import HandReader, OneEuroFilter, RecordedHand
from geort_drake.live.web.messages import Disengage, Engage, Fist, Hello, Reset, decode
from geort_drake.live.web.operator_station import is_fist
from geort_drake.people.keypoints import bone_lengths
from geort_drake.systems.retargeting_status import HELD_CLOCK, HELD_LOST, HELD_STALE
from geort_drake.systems.retargeting_system import SETTLING, TRACKING


@pytest.mark.parametrize("side", ["right", "left"])
def test_headset_and_camera_see_the_same_hand(side):
    """The same keypoints; the camera also finds where the wrist is, seen from itself."""
    p_CW = np.array([0.05, 0.02, 0.5])
    for number in (0, 100, 200):
        message = decode(headset(number, p_WK=in_world(number, side)))
        frame = HandReader(side).read(message)
        np.testing.assert_allclose(frame.p_HK, PLAY.p_HK[number], atol=1e-6)
        assert frame.time == pytest.approx(PLAY.t[number])
    for number, aspect in ((0, 4 / 3), (100, 9 / 16)):
        frame = HandReader("right").read(decode(camera(number, p_CW, aspect)))
        np.testing.assert_allclose(frame.p_HK, PLAY.p_HK[number], atol=1e-6)
        p_CH = R_CW @ in_world(number)[0] + p_CW
        np.testing.assert_allclose(frame.X_WH[4:], R_CW.T @ p_CH, atol=1e-6)


def test_a_persons_hand_has_its_own_length():
    """Whatever the device believes; joints that are no hand are refused."""
    for message in (headset(50), camera(50, np.array([0.0, 0.0, 0.6]))):
        p_HK = HandReader("right", 0.17).read(decode(message)).p_HK
        wrist_to_tip = [8, 9, 10, 11]  # the middle finger's bones
        assert bone_lengths(p_HK)[wrist_to_tip].sum() == pytest.approx(0.17)
    for message in (headset(0, p_WK=np.zeros((21, 3))), camera(0, np.array([0, 0, -0.5]))):
        with pytest.raises(LiveError, match="hand"):
            HandReader("right", 0.18).read(decode(message))


def test_the_filter_stills_a_hand_and_follows_a_fast_one():
    """Jitter of a resting point shrinks; a fast one lags little."""
    rng = np.random.default_rng(0)
    still = OneEuroFilter()
    noise = rng.normal(0.0, 1e-3, (300, 1, 3))
    out = np.array([still(i / 30, p) for i, p in enumerate(noise)])
    assert out[30:].std() < 0.5 * noise.std()
    fast = OneEuroFilter()
    for i in range(60):
        p = fast(i / 30, np.array([[i / 30, 0.0, 0.0]]))
    assert 0.0 < 59 / 30 - p[0, 0] < 0.02
    fast.reset()
    np.testing.assert_array_equal(fast(5.0, np.ones((1, 3))), 1.0)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_first_answer_tells_of_which_side_the_robot_is(side):
    """So that a page asks for the controls with that hand, which is then followed."""
    operated = station(side=side)
    answer = operated.join(1)
    assert (answer["role"], answer["side"], answer["hand"]) == ("spectator", side, f"allegro_{side}")
    assert operated.take(1, hello(side=answer["side"]))["role"] == "operator"
    for number in range(HANDSHAKE_FRAMES + 1):
        operated.take(1, headset(number, p_WK=in_world(number, side)))
    (hand,) = operated.drain()
    np.testing.assert_allclose(hand.p_HK, PLAY.p_HK[HANDSHAKE_FRAMES], atol=1e-6)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_mouse_moves_a_hand_that_pinches_as_people_do(side):
    """The wrist follows within a hand's speed, and each grip closes its own fingers on the thumb."""
    for grip, tip in (("index", 8), ("middle", 12), ("ring", 16), ("little", 20), ("hand", 12)):
        operated = station(side=side)
        operated.take(1, hello(side=side, device="pointer"))
        frames = []
        for i in range(60):
            pointer = {"t": i / 30, "x": 0.5, "y": -1.0, "z": 0.0, "grip": grip, "closed": i >= 15}
            operated.take(1, json.dumps({"type": "pointer", **pointer}))
            frames += operated.drain()
        p_HK, p_WH = np.array([f.p_HK for f in frames]), np.array([f.X_WH[4:] for f in frames])
        gap = np.linalg.norm(p_HK[:, 4] - p_HK[:, tip], axis=1)
        assert gap[10] > 0.06 and gap[-1] < 0.02, grip
        assert np.abs(np.diff(p_HK, axis=0)).max() * 30 < 0.8
        np.testing.assert_allclose(p_WH[-1], [0.0, -0.15 if side == "right" else 0.15, 0.25], atol=0.01)
        assert not operated.fist and not operated.commands


def test_a_recorded_hand_plays_itself():
    """Over and over, at the pace of the clock, without messages from the page."""
    operated = station()
    operated._play = lambda: RecordedHand(PLAY)
    operated.take(1, hello(device="recording"))
    frames = []
    for _ in range(500):
        operated._clock.now += 0.02
        frames += operated.drain()
    assert len(frames) == 500
    p_HK = np.array([frame.p_HK for frame in frames])
    period = round((PLAY.t[-1] - PLAY.t[0] + 1 / 30) / 0.02)
    np.testing.assert_allclose(p_HK[period : 2 * period - 300], p_HK[: period - 300], atol=0.01)
    operated.leave(1)
    assert operated.p_HK is None


def test_one_person_operates_and_others_look_on():
    operated = known(station())
    operated.join(2)
    assert operated.take(2, hello())["role"] == "spectator"
    assert operated.spectators == 1
    for message in (headset(9), '{"type": "engage"}'):
        with pytest.raises(LiveError, match="only the operator"):
            operated.take(2, message)
    operated.take(1, headset(10))
    operated.leave(1)
    assert isinstance(operated.commands.pop(), Disengage)
    assert [hand.p_HK is None for hand in operated.drain()] == [False, True]
    assert operated.received == 1  # the loss of a hand is none
    assert operated.p_HK is None
    assert operated.take(2, hello())["role"] == "operator"


def test_a_hand_of_the_other_side_is_refused_in_words():
    """By what the page says, and by the hand itself."""
    operated = station()
    with pytest.raises(MismatchError, match="use the other hand"):
        operated.take(1, hello(side="left"))
    operated.take(1, hello())
    with pytest.raises(GeortError, match="other side"):
        for number in range(HANDSHAKE_FRAMES):
            operated.take(1, headset(number, p_WK=in_world(number, "left")))
    assert operated.drain() == [] and operated.refused == 2


def test_a_real_robot_asks_twice():
    operated = known(station("real"))
    with pytest.raises(LiveError, match="once more"):
        operated.take(1, '{"type": "engage"}')
    assert not operated.commands
    operated.take(1, '{"type": "engage"}')
    assert isinstance(operated.commands[0], Engage)
    with pytest.raises(LiveError, match="real robot"):
        operated.take(1, '{"type": "reset"}')


@pytest.mark.parametrize("robot", ["simulation", "real"])
def test_a_held_fist_is_a_command(robot):
    """Once, after a second; an open hand is none, and for a real robot no fist is."""
    open_hand = next(p for p in PLAY.p_HK if not is_fist(p))
    fist = open_hand.copy()
    for base in (5, 9, 13, 17):
        fist[base + 3] = fist[base] + [0.03, 0.0, -0.01]
    assert is_fist(fist)
    operated, now = known(station(robot)), 0.0
    operated.drain()
    to_world = np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])
    shares = []
    for _ in range(30):
        now += 0.1
        operated._clock.now += 0.1
        operated.take(1, headset(0, 10.0 + now, fist @ to_world))
        shares.append(operated.fist)
    assert max(shares) == 1.0 and shares[-1] == 0.0
    assert [type(command) for command in operated.commands] == ([Fist] if robot == "simulation" else [])
    operated.take(1, headset(0, 20.0, open_hand @ to_world))
    assert operated.fist == 0.0


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('{"type": "jump"}', "jump"),
        ('{"type": "lost"}', "t"),
        ('{"type": "lost", "t": NaN}', "JSON"),
        ('{"type": "lost", "t": 1e400}', "message"),
        ('{"type": "lost", "t": -1}', "0"),
        ('{"type": "lost", "t": 1, "more": 2}', "more"),
        ('{"type": "headset", "t": 1, "joints": [[0, 0, 0]]}', "25"),
        (headset(0).replace("[[", "[[1e9, ", 1), "joints"),
        ('{"type": "record", "keep": false}', "keep"),
        (hello(version=2), "version"),
        ("x" * 70_000, "65536"),
        ("[" * 10_000, "message"),
        ("\ud800", "message"),
    ],
)
def test_a_malformed_message_is_refused_with_its_field(text, word):
    with pytest.raises(LiveError, match=word):
        decode(text)
    assert isinstance(decode(hello()), Hello)


def test_an_unknown_object_is_refused_with_the_choices():
    operated = known(station())
    with pytest.raises(LiveError, match="cube, cylinder, sphere"):
        operated.take(1, '{"type": "reset", "object": "moon"}')
    with pytest.raises(LiveError, match="there are grasp"):
        operated.take(1, '{"type": "reset", "task": "juggle"}')
    operated.take(1, '{"type": "reset", "object": "sphere"}')
    assert operated.commands[0] == Reset(object="sphere")


def test_another_hand_drops_who_moved_the_robot_but_not_who_watches():
    """The new hand may be of the other side; a simulated person suits any."""
    operated = known(station())
    with pytest.raises(LiveError, match="no hand 'claw'; there are none to choose"):
        operated.take(1, '{"type": "reset", "hand": "claw"}')
    left = station(side="left").about
    operated.change(left)
    assert operated.operator is None and isinstance(operated.commands[-1], Disengage)
    assert operated.welcome(1)["side"] == "left" and operated.welcome(1)["role"] == "spectator"
    operated.take(1, hello(device="simulated"))
    assert operated.simulated_person
    operated.change(station().about)
    assert operated.simulated_person


def test_a_watched_trial_goes_on_while_its_page_connects_again():
    """Loading a scene may keep a slow page from answering; a new trial would make it load the next scene."""
    operated = station()
    operated.join(1)
    operated.take(1, hello(device="simulated"))
    operated.leave(1)
    assert operated.operator is None and operated.simulated_person
    operated.join(2)
    operated.take(2, hello(device="simulated"))
    assert operated.simulated_person
    operated.leave(2)
    operated.join(3)
    operated.take(3, hello(device="camera"))
    assert not operated.simulated_person


def toy(p_HK: np.ndarray) -> np.ndarray:
    """Moves all joints with the middle fingertip, now and then beyond their limits."""
    return np.full(len(toy.joint_names), 20.0 * (p_HK[12, 2] - 0.1))


toy.joint_names = load_hand("allegro_right").joint_names


def toy_loop() -> LoopBench:
    """A loop with an engaged person."""
    bench = LoopBench(station(), toy)
    bench.engage(True)
    return bench


def test_a_page_that_sleeps_leaves_disengages_or_sets_its_clock_is_held_at_once_and_eased_back():
    bench = toy_loop()
    known(bench.station)

    def follow(t0: float, count: int = 60) -> list[str]:
        """States and broken limits while the page sends 50 hands a second."""
        seen = []
        for i in range(count):
            if i % 2 == 0:
                bench.station.take(1, headset(HANDSHAKE_FRAMES + i // 2, t0 + 0.01 * i))
            seen += [*bench.watch.broken(*bench.step()), bench.state()]
        return seen

    assert follow(100.0)[-1] == TRACKING
    asleep = [state for _ in range(40) for state in (*bench.watch.broken(*bench.step()), bench.state())]
    assert asleep[-1] == HELD_STALE
    awake = follow(101.6)
    assert any(state.startswith("easing") for state in awake) and awake[-1] == TRACKING
    bench.engage(False)
    disengaged = follow(103.0, 40)
    assert disengaged[-1] == "disengaged: held"
    np.testing.assert_array_equal(bench.step()[1], 0.0)
    bench.engage(True)
    engaged = follow(104.0)
    assert engaged[0] == SETTLING and engaged[-1] == TRACKING
    assert any(state.startswith("easing") for state in engaged)
    backwards = follow(50.0)
    assert HELD_CLOCK in backwards[:3] and backwards[-1] == TRACKING
    bench.station.leave(1)
    bench.step()
    bench.step()
    assert bench.state() == HELD_LOST
    states = {*asleep, *awake, *disengaged, *engaged, *backwards}
    assert not [state for state in states if "limit" in state and not state.startswith("limited")]


def test_whoever_is_refused_learns_why():
    """In the state, which terminal and page show, and in the counts that the report gets."""
    bench = toy_loop()
    known(bench.station)
    for i in range(50):
        bench.station.take(1, headset(HANDSHAKE_FRAMES + i, 100.0 + 0.01 * i))
        bench.step()
    assert bench.state() == TRACKING
    far = headset(0, 101.0).replace("[[", "[[99.0, ", 1)
    for _ in range(40):
        with pytest.raises(LiveError):
            bench.station.take(1, far)
        bench.step()
    assert bench.state().startswith("held: ") and "joints" in bench.station.last_refusal
    assert bench.state().endswith(f"; messages arrive but are refused: {bench.station.last_refusal}")
    bench.station.take(1, headset(60, 102.0))
    bench.step(0.03)
    assert "refused" not in bench.state()


def malformed(rng: np.random.Generator) -> str | bytes:
    """A message with one fault, or one that is well formed and absurd."""
    text = headset(int(rng.integers(len(PLAY.t))))
    fields, kind = json.loads(text), int(rng.integers(8))
    if kind < 3:
        return mutated(text.encode(), rng)
    if kind == 3:
        fields["joints"] = rng.normal(0.0, 10.0 ** rng.integers(-3, 3), (25, 3)).tolist()
    elif kind == 4:
        fields["t"] = float(10.0 ** rng.uniform(-9, 9))
    elif kind == 5:
        fields = {"type": str(rng.choice(["engage", "reset", "hello", "lost", "record", "", "💥"]))}
    else:
        fields = changed(fields, rng)
    return json.dumps(fields)


@pytest.mark.parametrize("hundreds", [20, pytest.param(100, marks=pytest.mark.slow)])
def test_malformed_messages_harm_nothing(hundreds):
    """The loop runs on; the hand's targets keep their limits; every message is counted once."""
    bench, rng = toy_loop(), np.random.default_rng(1)
    known(bench.station)
    told = 0
    for _ in range(hundreds):
        for _ in range(100):
            told += 1
            try:
                bench.station.take(1, malformed(rng))
            except GeortError:
                pass
        assert bench.watch.broken(*bench.step()) == []
        bench.station.commands.clear()
    assert bench.station.refused + bench.station.received <= told
    assert bench.station.refused > 0.5 * told
    robot = bench.loop.diagram.GetSubsystemByName("robot")
    hand = robot.GetOutputPort("hand_state")
    assert np.isfinite(hand.Eval(robot.GetMyContextFromRoot(bench.context))).all()
    t = 1e9
    for i in range(100):
        if i % 2 == 0:
            bench.station.take(1, headset(10 + i // 2, t - 2.0 + 0.01 * i))
        assert bench.watch.broken(*bench.step()) == []
    assert bench.state() == TRACKING
