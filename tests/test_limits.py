"""Faulty frames, wrist poses and commands break no limit, and updates do not grow the memory."""

import gc
import itertools
import math
import resource
from pathlib import Path

import numpy as np
import pytest
from faults.sound import LOWER, UPPER, play, smooth_retargeter
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_bench import PERIOD, ArmBench
from pydrake.math import RigidTransform, RollPitchYaw
from system_bench import Bench, Watch

from geort_drake.hands.collision import HandClearance
from geort_drake.systems.corrections import SelfCollisionGuard
from geort_drake.systems.joint_limits import JointLimits

PLAY = play()
VALID = st.sampled_from([1.0, 0.0, math.nan])
SEED = st.integers(0, 1000)
# Keypoints get a factor and noise in m, time stamps a shift in s. A frozen glove repeats frame and time.
FRAMES = st.fixed_dictionaries(
    {
        "keypoints": st.sampled_from([range(21), [0], [8]]),
        "factor": st.sampled_from([1.0, -1.0, 0.0, 0.1, 1.3, 1e3, 1e30, -1e300, math.nan, -math.inf]),
        "noise": st.sampled_from([0.0, 0.02, 0.3, 1e6]),
        "shift": st.sampled_from([0.0, -0.01, -1e9, math.nan]),
        "frozen": st.booleans(),
        "valid": VALID,
    }
)
SOUND = {"keypoints": [], "factor": 1.0, "noise": 0.0, "shift": 0.0, "frozen": False, "valid": 1.0}


def episodes(faults: st.SearchStrategy, sound: dict) -> st.SearchStrategy:
    """Lists of faults, or none, and for how many updates each lasts."""
    return st.lists(st.tuples(st.just(sound) | faults, st.integers(1, 60)), min_size=1, max_size=8)


@settings(max_examples=25, deadline=None)
@given(
    episodes=episodes(FRAMES, SOUND),
    seed=SEED,
    gain=st.sampled_from([1.0, 100.0]),
    period=st.sampled_from([0.002, 0.01, 0.033]),
    filters=st.sampled_from([{}, {"cutoff": 5.0}, {"latency": 0.001}]),
    stamped=st.booleans(),
)
def test_no_faulty_frame_breaks_a_limit(episodes, seed, gain, period, filters, stamped):
    """Commands are finite and within the limits of position, speed and acceleration."""
    rng, limits = np.random.default_rng(seed), JointLimits(LOWER, UPPER, 5.0, 200.0)
    bench = Bench(smooth_retargeter(gain), period, stamped, limits=limits, **filters)
    watch, number = Watch(limits, period), 0
    for fault, ticks in episodes:
        for _ in range(ticks):
            number += not fault["frozen"]
            p_HK = PLAY.p_HK[number % len(PLAY)].astype(float)
            part = list(fault["keypoints"])
            with np.errstate(invalid="ignore"):  # infinite times zero
                p_HK[part] = fault["factor"] * p_HK[part] + rng.normal(0.0, fault["noise"], (len(part), 3))
            q, v, _ = bench.tick(p_HK, fault["valid"], 100.0 + 0.01 * number + fault["shift"])
            assert watch.broken(q, v) == []


# Metres and radians are added to a wrist's pose: others in each update, or the same in an episode.
WRISTS = st.fixed_dictionaries(
    {
        "shift": st.sampled_from([0.0, 5e-3, 5.0, 99.0, math.nan, math.inf]),
        "turn": st.sampled_from([0.0, 0.02, 3.0]),
        "steady": st.booleans(),
        "valid": VALID,
    }
)


@settings(max_examples=8, deadline=None)
@given(episodes(WRISTS, {"shift": 0.0, "turn": 0.0, "steady": True, "valid": 1.0}), SEED)
def test_no_faulty_wrist_breaks_a_limit_of_the_arm(episodes, seed):
    bench, rng, tick = ArmBench(), np.random.default_rng(seed), itertools.count()
    for fault, ticks in episodes:
        aside = rng.uniform(-1.0, 1.0, 6)
        for _ in range(ticks):
            if not fault["steady"]:
                aside = rng.uniform(-1.0, 1.0, 6)
            phase = next(tick) * PERIOD * np.array([1.0, 1.7, 2.3])
            rpy = RollPitchYaw(0.3 * np.sin(phase) + fault["turn"] * aside[3:])
            p_WH = 0.15 * np.sin(1.3 * phase) + fault["shift"] * aside[:3]
            bench.tick(RigidTransform(rpy, p_WH), fault["valid"])
            assert not bench.broken


CLEARANCE = 0.002  # m


@pytest.fixture(scope="module")
def guard(allegro) -> SelfCollisionGuard:
    start = dict(zip(allegro.joint_names, allegro.default_position, strict=True))
    limits = JointLimits(allegro.lower, allegro.upper)
    return SelfCollisionGuard(allegro, allegro.joint_names, start, limits, PERIOD, CLEARANCE)


@pytest.fixture(scope="module")
def judge(allegro) -> HandClearance:
    return HandClearance(allegro, CLEARANCE)


@settings(max_examples=20, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from([1.0, 20.0, 1e300, math.nan, -math.inf]), st.integers(1, 40)),
        min_size=1,
        max_size=8,
    ),
    SEED,
)
def test_no_command_gets_past_the_guard(allegro, guard, judge, commands, seed):
    """For any command, the hand stays clear of itself and within its limits of position and speed.

    A command is a posture times a factor, for a number of steps.
    """
    rng, q = np.random.default_rng(seed), allegro.default_position
    reach = JointLimits(allegro.lower, allegro.upper).speed * PERIOD
    for factor, steps in commands:
        wanted = factor * rng.uniform(allegro.lower, allegro.upper)
        for _ in range(steps):
            before, q = q, guard.guard(wanted, q)
            assert ((allegro.lower <= q) & (q <= allegro.upper)).all()
            assert (np.abs(q - before) <= reach + 1e-12).all()
            assert not judge.near(q).pairs


def test_updates_do_not_grow_the_memory():
    """By less than they would if each kept 4 kB."""
    bench, retarget, frames = Bench(), smooth_retargeter(), PLAY.p_HK.astype(float)
    memory = []
    for updates in (300, 3_500):  # the first fill caches and pools
        for number in range(updates):
            bench.tick(frames[number % len(frames)], float(number % 997 > 5))
            retarget(frames[number % len(frames)])
        gc.collect()
        memory.append(int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize())
    assert memory[1] - memory[0] <= 10e6
