"""Each system of live use alone: glove stream, engage switch, watchdog, delay meter."""

import itertools
import json
import math
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_messages import Clock, Inbox, nodes_of, own_fields
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from shared import synthesized
from system_bench import SystemBench, Watch, joint_plant

from geort_drake import read_recording
from geort_drake.errors import LiveError, MismatchError, RecordingError
from geort_drake.live.glove_stream import MAX_LATENESS_S, GloveReceiver, GloveStream, SenderClock
from geort_drake.live.messages import GloveFrame, encode_frame
from geort_drake.live.session import STEADY_S, EnterKey, SteadyState, play, run_in_real_time
from geort_drake.live.teleoperation import DelayMeter
from geort_drake.live.watchdog import EngageSwitch, Watchdog
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.retargeting_status import FROZEN, HELD_LOST, HELD_STALE, LIMITED
from geort_drake.systems.retargeting_system import SETTLING, TRACKING, RetargetingStatus, RetargetingSystem

PLAY = synthesized(4, 6.0, 100.0)
PERIOD = 0.01


def message(i: int, **changes) -> bytes:
    fields = own_fields(PLAY.p_HK[i].astype(float), **{"time": float(PLAY.t[i]), **changes})
    return json.dumps(fields).encode()


class StreamBench(SystemBench):
    """A stream by itself, into which messages are put."""

    def __init__(self, *messages):
        self.inbox, self.clock = Inbox(*messages), Clock()
        self.glove = GloveReceiver(self.inbox, "right")
        self.stream = GloveStream(self.glove, clock=self.clock)
        super().__init__(self.stream, 0.004, 1.0)

    def after(self, *messages) -> dict:
        """What the ports give after the next polls."""
        self.inbox.messages += messages
        self.advance()
        ports = ("keypoints", "valid", "stamp", "sent", "lateness", "wrist_pose")
        return {name: self.value(name) for name in ports}


def test_the_stream_gives_the_newest_frame_and_holds_it():
    """Lost hands and malformed messages leave the keypoints as they were."""
    bench = StreamBench()
    start = bench.after()
    assert start["valid"] == 0
    assert np.isnan(start["sent"])
    for seen in (bench.after(message(5), message(7)), bench.after()):
        np.testing.assert_array_equal(seen["keypoints"], PLAY.p_HK[7].astype(float).ravel())
        assert seen["valid"] == 1
        assert seen["stamp"] == PLAY.t[7]
        np.testing.assert_array_equal(seen["wrist_pose"].translation(), [0.1, 0.2, 0.3])
    lost = bench.after(message(8, p_HK=None))
    assert lost["valid"] == 0
    assert lost["stamp"] == PLAY.t[8]
    np.testing.assert_array_equal(lost["keypoints"], PLAY.p_HK[7].astype(float).ravel())
    bad = bench.after(message(9), message(9, side="left"), b"{}")
    assert bad["stamp"] == PLAY.t[9]
    assert (bench.glove.received, bench.glove.refused) == (4, 2)
    assert bench.after(message(10, X_WH=[0.9, 0, 0, 0, 1, 2, 3]))["valid"] == 1
    assert "missing required field `format`" in bench.glove.last_refusal
    assert bench.glove.refusing == ""
    bench.after(message(11, side="left"))
    assert "a left hand is sent" in bench.glove.refusing


def test_a_flood_of_messages_is_not_decoded_whole():
    bench = StreamBench()
    assert bench.after(*[message(i) for i in range(100)])["stamp"] == PLAY.t[99]
    assert bench.glove.received <= 5


def test_a_stamp_of_this_machines_clock_gives_the_time_of_sending():
    """With another clock, or without a stamp, the arrival counts."""
    bench = StreamBench()
    bench.clock.now = 50.0
    assert bench.after(message(0, time=49.9))["sent"] == 49.9
    assert bench.after(message(0, time=3.0))["sent"] == 50.0
    words = ",".join(["id", *(str(float(x)) for p in nodes_of(PLAY.p_HK[3]) for x in (*p, 0, 0, 0, 1))])
    arrived = bench.after(words.encode())
    assert (arrived["stamp"], arrived["sent"]) == (50.0, 50.0)


def test_frames_that_come_late_are_not_followed():
    """Late is 0.2 s later than the fastest one, whatever the clocks and their drift."""
    bench = StreamBench()

    def arrives(stamp: float, delay: float) -> bool:
        bench.clock.now = 5000.0 + stamp * (1 + 5e-5) + delay
        return bool(bench.after(message(0, time=stamp))["valid"])

    assert arrives(10.0, 0.15)
    assert arrives(10.1, 0.0)
    assert bench.stream.sender_clock.offset == pytest.approx(5000.0, abs=1e-3)
    assert arrives(10.2, 0.15) and not arrives(10.3, 0.25) and not arrives(10.4, 9.0)
    assert bench.after()["lateness"] == pytest.approx(9.0, abs=1e-2)
    assert arrives(10.5, 0.01)
    # An hour later, the clocks differ by 0.18 s more.
    for second in range(11, 3611, 100):
        assert arrives(second, 0.1)
    assert bench.stream.late == 2
    # Another sender with its own clock starts anew.
    assert bench.after(message(0, time=3.0))["valid"]
    assert bench.stream.sender_clock.offset == pytest.approx(bench.clock.now - 3.0)


def slewed(rate: float, seconds: float):
    """Stamps of a clock that runs right but for `seconds` from t = 5 s on, when it runs at `rate`."""
    return lambda t: t - (1.0 - rate) * np.clip(t - 5.0, 0.0, seconds)


def lateness(
    rate_hz: float,
    stamp,
    delay,
    seconds: float = 40.0,
    jitter: float = 0.002,
    loss: float = 0.0,
    gathers: float = 0.0,
) -> np.ndarray:
    """How late each frame seems that is sent at t, with the stamp `stamp(t)`, and takes `delay(t)`, s.

    Args:
        rate_hz, seconds: of the frames that are sent.
        stamp, delay: functions of the time of sending, s.
        jitter: of the delay, s.
        loss: fraction of the frames that never arrive.
        gathers: time for which frames are gathered before they arrive together, s.
    """
    rng = np.random.default_rng(0)
    sent, burst = np.arange(0.0, seconds, 1.0 / rate_hz), max(1, round(gathers * rate_hz))
    together = sent[np.minimum(np.arange(len(sent)) // burst * burst + burst - 1, len(sent) - 1)]
    arrived = together + delay(sent) + rng.uniform(0.0, jitter, len(sent))
    kept = rng.uniform(size=len(sent)) >= loss
    sent, arrived = sent[kept], arrived[kept]
    clock, late = SenderClock(), []
    for arrival, measured in zip(np.maximum.accumulate(arrived), stamp(sent), strict=True):
        late.append(clock.lateness(arrival, measured))
    return np.array(late)


CLOCKS = {
    "right": lambda t: t,
    "slewed as fast as chrony does": slewed(1.0 - 0.083, 6.0),
    "slewed slowly": slewed(1.0 - 0.02, 25.0),
    "frame number over a rate 2 % too high": lambda t: t / 1.02,
    "frame number over a rate 2 % too low": lambda t: t * 1.02,
    "set back": lambda t: t - 0.5 * (t >= 5.0),
    "set forward": lambda t: t + 0.5 * (t >= 5.0),
}


LINKS = {
    "a cable": {},
    "a radio that loses frames": {"loss": 0.1},
    "a bus that gathers frames": {"gathers": 0.034},
    "a network with jitter": {"jitter": 0.03},
}


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("rate_hz", [30.0, 100.0])
@pytest.mark.parametrize("name", CLOCKS)
def test_no_clock_makes_punctual_frames_late_for_ever(name, rate_hz, link):
    """A clock that is set forward makes them seem early, which shows at once."""
    late = lateness(rate_hz, CLOCKS[name], np.zeros_like, **LINKS[link])
    assert (late[-round(5 * rate_hz) :] < (0.05 if link == "a cable" else 0.15)).all()
    assert np.mean(late > MAX_LATENESS_S) == 0.0


def test_a_clock_too_slow_to_be_corrected_is_named():
    """Frames of a frame counter at 30 Hz that come at 25 Hz count as late, and the person learns why."""
    bench = StreamBench()
    for number in range(400):
        bench.clock.now = 5000.0 + number / 25.0
        arrived = bench.after(message(0, time=number / 30.0))
    assert not arrived["valid"]
    assert "come later and later" in bench.stream.notice
    assert bench.stream.notice.endswith("its time stamps count 0.8 s in a second")


DELAYS = {
    "a queue grows by 8 %": lambda t: 0.08 * np.clip(t - 10.0, 0.0, 10.0),
    "a queue grows by 5 %": lambda t: 0.05 * np.clip(t - 10.0, 0.0, None),
    "a longer way": lambda t: 0.4 * (t >= 10.0),
    "two longer ways": lambda t: 0.15 * (t >= 10.0) + 0.15 * (t >= 10.6),
}


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("rate_hz", [60.0, 100.0])
@pytest.mark.parametrize("name", DELAYS)
def test_frames_that_are_really_late_stay_late(name, rate_hz, link):
    """Whether they queue up on their way, or their way gets longer."""
    late = lateness(rate_hz, lambda t: t, DELAYS[name], **LINKS[link])
    # With lost frames, the time of each is known only roughly.
    count = len(late) / 40.0
    assert (late[: round(9 * count)] < 0.06).all()
    assert (late[round(22 * count) :] > MAX_LATENESS_S).all()


def served(*batches: list[bytes]) -> GloveReceiver:
    """A glove whose messages arrive in batches."""
    inbox = Inbox()
    inbox.drain = iter(batches).__next__
    return GloveReceiver(inbox, "right")


def hands(points: np.ndarray) -> list[list[bytes]]:
    return [[encode_frame(GloveFrame("right", float(i), p))] for i, p in enumerate(points)]


def test_the_handshake_waits_for_a_hand():
    """It ignores malformed messages before it, and reports them if no hand comes.

    Another kind of glove is refused without waiting for the timeout.
    """
    glove = served([b"{}"], *hands(PLAY.p_HK[::60].astype(float)))
    glove.handshake(timeout_s=20.0)
    assert glove.refused == 1
    with pytest.raises(LiveError, match=r"no hand came from the glove within 0.01 s$"):
        GloveReceiver(Inbox(), "right").handshake(timeout_s=0.01)
    with pytest.raises(LiveError, match=r"1 messages were refused, the last: glove message: Object missing"):
        GloveReceiver(Inbox(b"{}"), "right").handshake(timeout_s=0.01)
    with pytest.raises(MismatchError, match="a left hand is sent"):
        GloveReceiver(Inbox(message(0, side="left")), "right").handshake(timeout_s=1e6)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda p: p * [-1, 1, 1], r"behind the palm .* of the other side"),
        (lambda p: p * [1, -1, 1], "in the wrist frame H"),
        (lambda p: 1000 * p / 25.4, "must be 60 to 110 mm, but is 3"),
        (lambda p: p[:, [0, *range(5, 21), *range(1, 5)]], "wrong joint order"),
        (lambda p: p[..., [2, 0, 1]], "in the wrist frame H"),
    ],
    ids=["other side", "mirrored", "inches", "order", "axes"],
)
def test_the_handshake_refuses_other_hands(change, expected):
    """Mirrored ones, and those in another unit, frame or order of joints."""
    with pytest.raises((RecordingError, MismatchError), match=expected):
        served(*hands(change(PLAY.p_HK.astype(float))[::60])).handshake(timeout_s=20.0)


@pytest.mark.parametrize("name", ["alex_npy", "manus_npz"])
def test_the_handshake_accepts_real_hands_in_any_posture(name, request):
    """Also with straight fingers, which may bend backwards."""
    recording = read_recording(request.getfixturevalue(name))
    points = recording.p_HK[recording.valid].astype(float)
    for first in range(0, len(points) - 5, 100):
        served(*hands(points[first : first + 5])).handshake(timeout_s=20.0)


def test_playback_sends_every_frame_when_it_is_due():
    """With its time on the sender's clock."""

    class Stop:
        """An event that is never set, whose waiting moves the clock."""

        def wait(self, seconds):
            clock.now += seconds
            return False

    clock, sent = Clock(7.0), []
    assert play(PLAY, sent.append, Stop(), clock) == len(PLAY)
    frames = [json.loads(text) for text in sent]
    np.testing.assert_allclose([frame["time"] for frame in frames], 7.0 + PLAY.t - PLAY.t[0])
    np.testing.assert_array_equal([frame["p_HK"] for frame in frames], PLAY.p_HK.astype(float))


def test_engaging_never_makes_the_joints_jump():
    """The glove moves while the person is disengaged; then the hand eases to it within its limits."""
    limits = JointLimits(np.full(4, -1.0), np.full(4, 1.0))
    retarget = lambda points: np.clip(10 * points[[4, 8, 12, 16], 0], -1, 1)  # noqa: E731
    names = ["a", "b", "c", "d"]
    builder = DiagramBuilder()
    stream = StreamBench()
    glove = builder.AddSystem(stream.stream)
    switch = builder.AddSystem(EngageSwitch())
    retargeting = builder.AddSystem(
        RetargetingSystem(
            retarget,
            *joint_plant(tuple(names)),
            joint_names=names,
            initial_positions=dict.fromkeys(names, 0.3),
            period=PERIOD,
            limits=limits,
        )
    )
    builder.Connect(glove.GetOutputPort("valid"), switch.GetInputPort("valid"))
    builder.Connect(glove.GetOutputPort("keypoints"), retargeting.GetInputPort("keypoints"))
    builder.Connect(switch.GetOutputPort("valid"), retargeting.GetInputPort("valid"))
    builder.ExportInput(switch.GetInputPort("engaged"), "engaged")
    bench = SystemBench(builder.Build(), PERIOD, 1.0)

    def tick(i: int, engaged: bool):
        bench.fix(engaged=engaged)
        stream.inbox.messages.append(message(i))
        bench.advance()
        return bench.value("desired_state", retargeting)[:4], bench.value("status", retargeting).state

    held = [tick(i, False) for i in range(100)]
    assert all((q == 0.3).all() for q, _ in held)
    assert held[-1][1] == HELD_LOST
    followed = [tick(i, True) for i in range(100, 250)]
    q = np.array([q for q, _ in followed])
    wanted = retarget(PLAY.p_HK[100].astype(float))
    # Full speed is reached after half a second of easing.
    assert np.abs(wanted - 0.3).max() > 0.2
    assert np.abs(np.diff(np.vstack([held[-1][0], q]), axis=0))[:25].max() <= 0.5 * 7.0 * PERIOD
    assert followed[-1][1] == TRACKING
    np.testing.assert_allclose(q[-1], retarget(PLAY.p_HK[248].astype(float)), atol=0.1)
    stopped = [tick(i, False) for i in range(250, 300)]
    assert (stopped[-1][0] == stopped[-2][0]).all()


LIMITS = JointLimits(np.full(3, -1.0), np.full(3, 2.0), 4.0, 200.0)
SAFE = np.array([0.1, 0.5, -0.2])


class WatchdogBench(SystemBench):
    """Steps a watchdog alone."""

    def __init__(self, limits=LIMITS, safe=SAFE, **config):
        super().__init__(Watchdog(limits, safe, PERIOD, **config))

    def tick(self, q, v=(0.0, 0.0, 0.0), state=TRACKING, engaged=True):
        """One period; returns the positions, the velocities, and the values of the other two ports."""
        self.fix(desired_state=[*q, *v], status=RetargetingStatus(state), engaged=engaged)
        self.advance()
        following, state = self.value("following")[0], self.value("state")
        return *np.split(self.value("desired_state"), 2), following, state


def motion(tick: int) -> tuple[np.ndarray, np.ndarray]:
    """Commands that move within the limits."""
    phase = tick * PERIOD + np.array([0.0, 1.0, 2.0])
    return 0.5 + 0.4 * np.sin(3 * phase), 1.2 * np.cos(3 * phase)


def test_the_watchdog_passes_commands_on_to_the_last_bit():
    """Also while the glove is lost for less than `relax_after`."""
    bench = WatchdogBench(relax_after=1.0)
    for tick in range(200):
        q, v = motion(tick)
        state = HELD_STALE if 50 <= tick < 100 else TRACKING
        out_q, out_v, following, _ = bench.tick(q, v, state)
        np.testing.assert_array_equal([out_q, out_v], [q, v])
        assert following == (state == TRACKING)


@pytest.mark.parametrize("state", [HELD_STALE, HELD_LOST, FROZEN, SETTLING])
def test_the_hand_relaxes_when_the_glove_stays_lost_and_returns_to_the_commands(state):
    """Slowly, to the safe pose, where it stays; commands that move meanwhile pass on as they are."""
    bench = WatchdogBench(relax_after=0.5, relax_speed=0.8, ease_time=0.4)
    held = np.array([1.5, -0.9, 0.4])
    bench.tick(held)
    out = [bench.tick(held, state=state) for _ in range(400)]
    q = np.array([o[0] for o in out])
    assert (q[:50] == held).all()
    assert (q[53] != held).any()
    np.testing.assert_array_equal(q[-1], SAFE)
    assert np.abs(np.diff(q, axis=0)).max() <= 0.8 * PERIOD * (1 + 1e-9)
    assert out[60][3].startswith("relaxing")
    assert not any(o[2] for o in out)
    returned = [bench.tick(*motion(tick)) for tick in range(450)]
    assert returned[0][3].startswith("returning") and returned[-1][3] == TRACKING
    np.testing.assert_array_equal(returned[-1][:2], motion(449))


def test_a_disengaged_hand_never_relaxes():
    """Also when the person disengages while it relaxes."""
    bench = WatchdogBench(relax_after=0.1)
    held = np.full(3, 1.2)
    for _ in range(300):
        np.testing.assert_array_equal(bench.tick(held, state=HELD_LOST, engaged=False)[0], held)
    for _ in range(50):
        moving = bench.tick(held, state=HELD_LOST)[0]
    stopped = [bench.tick(held, state=HELD_LOST, engaged=False) for _ in range(50)]
    assert (stopped[-1][0] == stopped[10][0]).all()
    assert np.abs(stopped[-1][0] - moving).max() < 0.05
    assert stopped[-1][3] == "disengaged: held"


EVENTS = st.tuples(st.sampled_from([TRACKING, HELD_STALE, FROZEN]), st.booleans(), st.integers(1, 40))


@settings(max_examples=40, deadline=None)
@given(st.lists(EVENTS, max_size=8), st.integers(0, 2))
def test_the_watchdog_keeps_the_limits(events, seed):
    """In whichever order the glove is lost and found and the person engages, while commands move fast."""
    limits = JointLimits(np.full(3, -1.5), np.full(3, 1.5), 7.0, 100.0)
    bench = WatchdogBench(limits, np.zeros(3), relax_after=0.05, relax_speed=0.5, ease_time=0.05)
    rng, watch = np.random.default_rng(seed), Watch(limits, PERIOD, 0.0)
    q = v = target = reported = at = speed = np.zeros(3)
    for state, engaged, ticks in events:
        for _ in range(ticks):
            # Retargeting holds what it does not follow.
            followed, before = state == TRACKING and engaged, target
            phase = 3.0 * bench.ticks * PERIOD * rng.uniform(0.98, 1.02, 3) + [0, seed, 2 * seed]
            target = 1.2 * np.sin(phase) if followed else q
            q, v = limits.step(q, v, target, before if followed else q, PERIOD)
            out, velocity, *_ = bench.tick(q, v, state, engaged)
            assert {*watch.broken(out, velocity)} <= {"consistent velocity"}
            # What is reported, and what follows from the positions.
            assert np.abs(velocity - reported).max() <= 100.0 * PERIOD + 1e-9
            assert np.abs((out - at) / PERIOD - speed).max() <= 100.0 * PERIOD + 1e-9
            reported, speed, at = velocity, (out - at) / PERIOD, out


def test_settings_that_cannot_work_are_refused():
    """With the name of the setting."""
    for name, value in (("relax_after", 0.0), ("relax_speed", math.inf), ("ease_time", math.nan)):
        with pytest.raises(ValueError, match=name):
            Watchdog(LIMITS, SAFE, PERIOD, **{name: value})


def test_a_state_is_shown_once_it_has_lasted():
    """So that nothing flickers; limits that a moving hand reaches are not shown at all."""
    steady = SteadyState()
    assert steady.step(0.0, HELD_LOST) == HELD_LOST
    for time in np.arange(0.1, 5.0, 0.1):
        state = TRACKING if round(10 * time) % 2 else HELD_STALE
        assert steady.step(time, state) == HELD_LOST
    steady.step(4.95, HELD_STALE)
    assert steady.step(5.0, TRACKING) == steady.step(5.0 + 0.9 * STEADY_S, LIMITED) == HELD_LOST
    assert steady.step(5.01 + STEADY_S, TRACKING) == steady.step(6.0, LIMITED) == TRACKING


def test_every_newline_of_a_pipe_is_a_press():
    """Half a line does not block, and the end of the pipe is reported."""
    reader, writer = os.pipe()
    key = EnterKey(reader)
    try:
        assert key.presses() == 0
        os.write(writer, b"\n\nhalf a li")
        assert key.presses() == 2
        assert key.presses() == 0
        os.write(writer, b"ne\n")
        os.close(writer)
        assert key.presses() == 1
        assert key.presses() is None
    finally:
        os.close(reader)


def test_a_loop_that_is_late_does_not_hurry():
    """Its time continues from where it is, and it counts how often that was."""
    simulator = Simulator(EngageSwitch())
    clock = itertools.count(0.0, 1.0)  # a second passes between any two looks
    steps = iter([True, True, True, False])
    assert run_in_real_time(simulator, 0.001, lambda: next(steps), lambda: next(clock)) == 3
    assert simulator.get_context().get_time() == pytest.approx(0.003)


def test_the_meter_measures_how_long_commands_take():
    """Held commands and old keypoints do not count."""
    clock = Clock(10.0)
    meter = DelayMeter(1, PERIOD, clock)
    assert meter.delay() == {"count": 0, "median": None, "p99": None}
    bench = SystemBench(meter, PERIOD, 0.9)
    for tick in range(10):
        sent = 10.0 + tick * PERIOD - 0.004 if tick else math.nan
        bench.fix(sent=sent, command=[min(tick, 5), 0.0])
        clock.now = 10.0 + tick * PERIOD
        bench.advance()
    # A joint that lags causes new commands from old keypoints.
    bench.fix(command=[6.0, 0.0])
    bench.advance()
    assert meter.delay() == {"count": 5, "median": pytest.approx(0.004), "p99": pytest.approx(0.004)}
    assert meter.delay(2)["count"] == 2
