"""What is sent between glove, loop and robot: it arrives as it was sent, and bad messages are refused."""

import json
import struct

import numpy as np
import pytest
from drake import lcmt_allegro_command, lcmt_allegro_status, lcmt_panda_command
from hypothesis import given, settings
from hypothesis import strategies as st
from live_messages import manus_glove, manus_words, nodes_of, own_fields

from geort_drake.errors import HandError, LiveError, MismatchError
from geort_drake.live.decoding import decode
from geort_drake.live.devices import ALLEGRO, PANDA, JointStatus
from geort_drake.live.glove_frame import MAX_BYTES, GloveFrame, encode_frame
from geort_drake.live.joint_group import JointGroup
from geort_drake.live.transports import (
    LOCAL_LCM,
    heard_from_outside,
    is_local,
    open_receiver,
    open_sender,
    split_address,
    wait_for,
)
from geort_drake.people.play import synthesize_play

HAND = synthesize_play(3, duration_s=1.0, rate_hz=30.0).p_HK[20].astype(float)


def dumped(fields: dict) -> bytes:
    return json.dumps(fields).encode()


# -- gloves


def test_a_frame_arrives_to_the_last_bit():
    """Also one of a lost hand, and one without a tracker."""
    pose = np.array([0.6, 0.8, 0.0, 0.0, 1 / 3, -2.0, 0.7])
    for sent in (
        GloveFrame("right", 1e9 + 1 / 3, HAND, pose),
        GloveFrame("right", 0.0, None, pose),
        GloveFrame("right", -4.0, HAND),
    ):
        got = decode(encode_frame(sent), "right")
        assert got is not None
        assert (got.side, got.time) == (sent.side, sent.time)
        for name in ("p_HK", "X_WH"):
            np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))


@pytest.mark.parametrize("side", ["right", "left"])
def test_manus_bridges_give_the_same_hand(side):
    """Text and ManusGlove, from a frame that stands elsewhere, of either side."""
    p_WN = nodes_of(HAND, side)
    text = ",".join(manus_words("60f3738b", p_WN)).encode()
    for message in (text, dumped(manus_glove(p_WN, side.upper()))):
        frame = decode(message, side)
        assert frame is not None
        assert frame.time is None
        np.testing.assert_allclose(frame.p_HK, HAND, atol=1e-6)
        assert frame.X_WH is not None
        np.testing.assert_allclose(np.linalg.norm(frame.X_WH[:4]), 1.0)


def test_of_two_manus_gloves_the_wanted_one_is_taken():
    """In one message or in several; without a serial number, two are refused."""
    one, other = manus_words("aa", nodes_of(HAND)), manus_words("BB", nodes_of(1.05 * HAND))
    both = ",".join(one + other).encode()
    frame = decode(both, "right", "bb")
    assert frame is not None
    np.testing.assert_allclose(frame.p_HK, 1.05 * HAND, atol=1e-6)
    assert decode(",".join(one).encode(), "right", "bb") is None
    assert decode(dumped(manus_glove(nodes_of(HAND), glove_id=7)), "right", "8") is None
    assert decode(dumped(manus_glove(nodes_of(HAND), glove_id=8)), "right", "8") is not None
    with pytest.raises(MismatchError, match=r"two gloves; choose one with --glove-id: aa, BB"):
        decode(both, "right")


NODES = manus_glove(nodes_of(HAND))
WORDS = manus_words("aa", nodes_of(HAND))
REFUSED = {
    "empty": (b"", "values are wanted"),
    "no text": (bytes(range(256)), "values are wanted"),
    "no JSON": (b"{'side': 1}", "not JSON"),
    "cut off": (dumped(own_fields(HAND))[:-1], "not JSON"),
    "not UTF-8": (b'{"format": "\xff"}', "not JSON"),
    "deeply nested": (b'{"a":' * 10_000, "not JSON"),
    "another object": (b"{}", "neither of format"),
    "too long": (dumped(own_fields(HAND)) + b" " * MAX_BYTES, "at most 65536 are read"),
    "NaN": (dumped(own_fields(HAND, time=float("nan"))), "NaN is no number"),
    "infinity": (dumped(own_fields(HAND)).replace(b"12.5", b"1e999"), "time must be finite"),
    "a huge integer": (dumped(own_fields(HAND, time=10**400)), "time must be finite"),
    "no time": (dumped(own_fields(HAND, time=None)), "time must hold 1 numbers"),
    "a missing field": (dumped(own_fields(HAND, X_WH=...)), "differs in X_WH"),
    "an unknown field": (dumped(own_fields(HAND, wrist=1)), "differs in wrist"),
    "20 keypoints": (dumped(own_fields(HAND[:20])), "p_HK must be 21 points"),
    "flat keypoints": (dumped(own_fields(HAND[:, :2])), "p_HK must hold 3 numbers"),
    "keypoints of words": (dumped(own_fields(HAND, p_HK=[["a", "b", "c"]] * 21)), "p_HK must hold 3"),
    "keypoints of truth": (dumped(own_fields(HAND, p_HK=[[True, 0, 0]] * 21)), "p_HK must hold 3"),
    "keypoints far away": (dumped(own_fields(1e4 * HAND)), "at most 100"),
    "half a quaternion": (dumped(own_fields(HAND, X_WH=[0.5, 0, 0, 0, 0, 0, 0])), "unit quaternion"),
    "no side": (dumped(own_fields(HAND, side="both")), "side must be one of left, right"),
    "24 nodes": (dumped({**NODES, "raw_nodes": NODES["raw_nodes"][:24]}), "must be 25 nodes"),
    "a node twice": (dumped({**NODES, "raw_nodes": [NODES["raw_nodes"][0]] * 25}), "must be finite"),
    "a node of no number": (dumped({**NODES, "raw_nodes": [{"node_id": 25}] * 25}), "node_id from 0 to 24"),
    "nodes of nothing": (dumped({**NODES, "raw_nodes": [None] * 25}), "node_id from 0 to 24"),
    "no nodes": (dumped({**NODES, "raw_nodes": 25}), "must be 25 nodes"),
    "175 words": (",".join(WORDS[:175]).encode(), "not 175"),
    "words of no number": (",".join([*WORDS[:9], "x", *WORDS[10:]]).encode(), "could not convert"),
    "NaN in text": (",".join([*WORDS[:8], "nan", *WORDS[9:]]).encode(), "must be finite"),
    "a palm that is a point": (",".join(["a", *["0"] * 175]).encode(), "span a plane"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_bad_message_is_refused(name):
    """With an error that says what was wanted, whatever it is."""
    message, told = REFUSED[name]
    with pytest.raises(LiveError, match=told) as raised:
        decode(message, "right")
    assert len(str(raised.value)) < 300


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (dumped(own_fields(HAND, version=2)), "version must be 1, which is read here, not 2"),
        (dumped(own_fields(HAND, version=True)), "version must be 1"),
        (dumped(own_fields(HAND, version=...)), "version must be 1, which is read here, not None"),
        (dumped(own_fields(HAND, unit="mm")), "unit must be 'm', which is read here, not 'mm'"),
        (dumped(own_fields(HAND, side="left")), "a left hand is sent, the robot's is a right one"),
        (dumped(manus_glove(nodes_of(HAND, "left"), "Left")), "a left hand is sent"),
        (",".join(["0.5"] * 40).encode(), "joint angles"),
    ],
    ids=["version", "no number", "no version", "unit", "side", "ManusGlove", "ergonomics"],
)
def test_what_waiting_cannot_mend_is_a_mismatch(message, told):
    """Another version, unit or hand, and angles in place of positions."""
    with pytest.raises(MismatchError, match=told):
        decode(message, "right")


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_a_broken_message_never_does_more_than_be_refused(data):
    """Bytes changed, left out and put in, in each of the three forms."""
    forms = (dumped(own_fields(HAND)), dumped(NODES), ",".join(WORDS).encode())
    message = bytearray(data.draw(st.sampled_from(forms)))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(message) - 1))
        message[place : place + data.draw(st.integers(0, 8))] = data.draw(st.binary(max_size=4))
    try:
        frame = decode(bytes(message), "right")
    except LiveError:
        return
    if frame is not None and frame.p_HK is not None:
        assert frame.p_HK.shape == (21, 3)
        assert np.isfinite(frame.p_HK).all()


# -- robots


def status_of(device) -> JointStatus:
    n = len(device.joints)
    return JointStatus(np.arange(n) / 7, -np.arange(n) / 3, np.arange(n) / 9)


@pytest.mark.parametrize("device", [ALLEGRO, PANDA], ids=lambda device: device.name)
def test_commands_and_statuses_arrive_to_the_last_bit(device):
    """In Drake's messages."""
    sent = status_of(device)
    np.testing.assert_array_equal(
        device.decode_command(device.encode_command(1.0, sent.position)), sent.position
    )
    got = device.decode_status(device.encode_status(1.0, sent))
    for name in ("position", "velocity", "commanded"):
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))


def test_commands_are_drakes():
    """Their fields say what the drivers expect."""
    command = lcmt_allegro_command.decode(ALLEGRO.encode_command(2.5, np.arange(16.0)))
    assert (command.utime, command.num_joints, command.num_torques) == (2_500_000, 16, 0)
    assert list(command.joint_position) == list(range(16))
    command = lcmt_panda_command.decode(PANDA.encode_command(2.5, np.arange(7.0)))
    assert (command.num_joint_position, command.num_joint_velocity, command.num_joint_torque) == (7, 0, 0)
    assert command.control_mode_expected == 1  # position


@pytest.mark.parametrize("device", [ALLEGRO, PANDA], ids=lambda device: device.name)
def test_bad_messages_of_robots_are_refused(device):
    """Cut off, of another type or size, not finite, or with a length inside that is not theirs."""
    n = len(device.joints)
    status, command = device.encode_status(1.0, status_of(device)), device.encode_command(1.0, np.zeros(n))
    sizes = struct.pack(">i", n)
    for decode_it, good in ((device.decode_status, status), (device.decode_command, command)):
        nan = good.replace(struct.pack(">d", 0.0), struct.pack(">d", np.nan), 1)
        if decode_it == device.decode_command:
            nan = device.encode_command(1.0, np.full(n, np.inf))
        for bad in (
            b"",
            good[:-1],
            good + b"\0",
            b"\0" * len(good),
            good.replace(sizes, struct.pack(">i", 2**31 - 1), 1),
            good.replace(sizes, struct.pack(">i", -1), 1),
            nan,
        ):
            with pytest.raises(LiveError, match=device.name):
                decode_it(bad)


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_a_broken_message_of_a_robot_never_does_more_than_be_refused(data):
    """Bytes changed at random places, the length kept; what is taken is finite."""
    device = data.draw(st.sampled_from([ALLEGRO, PANDA]))
    message = bytearray(device.encode_status(1.0, status_of(device)))
    for _ in range(data.draw(st.integers(1, 8))):
        message[data.draw(st.integers(0, len(message) - 1))] = data.draw(st.integers(0, 255))
    try:
        status = device.decode_status(bytes(message))
    except LiveError:
        return
    for values in (status.position, status.velocity, status.commanded):
        assert np.isfinite(values).all()


def test_a_hand_of_other_joints_is_refused():
    """By the number in its status, and by the names in the model."""
    status = lcmt_allegro_status()
    status.num_joints = 12
    for field in status.__slots__[2:]:
        setattr(status, field, [0.0] * 12)
    with pytest.raises(LiveError, match="Is this the hand that the robot has"):
        ALLEGRO.decode_status(status.encode())
    with pytest.raises(HandError, match="the model's hand has thumb"):
        ALLEGRO.require_joints(JointGroup("hand", ["thumb"], np.zeros(1), np.zeros(1), np.ones(1)))


# -- transports


@pytest.mark.parametrize("pattern", ["pub", "push"])
def test_messages_pass_over_zeromq_on_loopback(pattern):
    """On a port that the system chooses; the last part of several counts."""
    sender = open_sender(f"{pattern}+tcp://127.0.0.1:0")
    try:
        receiver = open_receiver(("sub+" if pattern == "pub" else "pull+") + sender.endpoint)
        try:

            def poll():
                sender.send(b"hello")
                return receiver.drain() or None

            assert set(wait_for(poll, 20.0, lambda: "nothing came")) == {b"hello"}
        finally:
            receiver.close()
        with pytest.raises(LiveError, match="cannot listen there"):
            open_sender(f"{pattern}+{sender.endpoint}")
    finally:
        sender.close()


@pytest.mark.parametrize(
    "address",
    [
        "", "tcp://127.0.0.1:1", "sub+tcp://127.0.0.1", "sub+udp://127.0.0.1:5", "req+tcp://127.0.0.1:5",
        "lcm+memq://", "lcm+udpm://127.0.0.1:7667?ttl=0", "lcm+udpm://239.255.76.67:7667",
        "lcm+udpm://239.255.76.67:99999?ttl=0", "lcm+tcpq://127.0.0.1:7700",
    ],
)  # fmt: skip
def test_a_bad_address_is_refused(address):
    """LCM itself takes any, and then nothing arrives."""
    with pytest.raises(LiveError, match=r"give one of|wants udpm"):
        split_address(address, ("sub", "pull"))


def test_what_the_network_can_reach_is_told_apart():
    """The defaults stay on this machine."""
    assert all(map(is_local, ("lcm", "lcm+udpm://239.1.1.1:7667?ttl=0", "pub+tcp://127.0.0.1:5556")))
    assert not any(
        map(is_local, ("lcm+udpm://239.1.1.1:7667?ttl=1", "pub+tcp://*:1", "sub+tcp://10.0.0.1:1"))
    )


def test_an_lcm_group_that_is_routed_to_a_network_is_told(tmp_path):
    """The narrowest route counts, and of equal ones the one of the lowest metric; a table there must be."""
    table = tmp_path / "route"
    head = "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT\n"
    default = "eth0\t00000000\t010200C0\t0003\t0\t0\t100\t00000000\t0\t0\t0\n"
    ours = "{}\t434CFFEF\t00000000\t0005\t0\t0\t{}\tFFFFFFFF\t0\t0\t0\n"
    for routes, outside in (
        (default, True),
        (default + ours.format("lo", 0), False),
        (ours.format("lo", 5) + default + ours.format("eth0", 0), True),
        ("", False),
    ):
        table.write_text(head + routes)
        assert heard_from_outside(LOCAL_LCM, table) == outside
    assert heard_from_outside(LOCAL_LCM, tmp_path / "none")
