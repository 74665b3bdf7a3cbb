"""The recording of a training: what was observed, and that observing changes nothing."""

import numpy as np
import pytest
import torch
from rerun_world import read, rerun

from geort_drake.comparison import training_recording as scene
from geort_drake.comparison.training_recording import TrainingRecorder
from geort_drake.retargeting.training.descent import descend
from geort_drake.retargeting.training.networks import RetargetingNetwork


def make_network(hand):
    fingers = len(hand.finger_names)
    mean, scale = torch.full((fingers, 3), 0.05), torch.full((fingers, 3), 0.05)
    return RetargetingNetwork(hand.kinematics(), mean, scale, 8, torch.Generator().manual_seed(0))


@pytest.fixture
def network(allegro):
    return make_network(allegro)


def move(network):
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.mul_(1.5)


def test_training_is_the_same_when_it_is_observed(allegro, play):
    """The weights are kept as they were at each step, and observing changes none of them."""
    hands = torch.full((4, len(allegro.finger_names), 3), 0.1)

    def train(report=None):
        network, outputs = make_network(allegro), []

        def losses(_step):
            answer = network(hands)
            outputs.append(answer.detach())
            loss = answer.square().sum()
            return loss, {"size": loss}

        descend(network, losses, 300, 0.01, report)
        return torch.stack(outputs)

    recorder = TrainingRecorder(allegro, play)
    observed = train(recorder.observe)
    assert torch.equal(observed, train())
    assert list(recorder._weights) == [1, 2, *range(4, 300, 3)]
    for step, weights in recorder._weights.items():
        np.testing.assert_allclose(recorder._map(weights)(hands.numpy()), observed[step], atol=1e-6)


def test_the_recording_holds_each_map_as_it_was(tmp_path, allegro, play, network, monkeypatch):
    """Robot hand, reach, pinches and criteria at each step are those of that step's weights."""
    monkeypatch.setattr(scene, "_SAMPLES", 2000)
    monkeypatch.setattr(scene, "_COLLIDING", 10)
    recorder = TrainingRecorder(allegro, play)
    kept = []
    for step in (1, 50, 100):
        losses = {"step": step - 1, "total": 2.0, "pinch": 1.0 / step, "seconds": 0.1}
        recorder.observe(step, 100, losses, network)
        kept.append({name: value.clone() for name, value in network.state_dict().items()})
        move(network)

    def trained(p_HF):
        return np.tile(allegro.default_position, (len(p_HF), 1))

    path = tmp_path / "training.rrd"
    properties = {"method": "geort", "hand": "allegro_right", "seed": 0}
    recorder.write(path, trained, properties)
    assert rerun("rrd", "verify", path).returncode == 0

    steps, closed = read(path, "/criteria/pinch", "Scalars:scalars", timeline="step")
    assert steps == [1, 50, 100]
    steps, pinch = read(path, "/losses/pinch", "Scalars:scalars", timeline="step")
    assert (steps, np.ravel(pinch).tolist()) == ([0, 49, 99], [1.0, 0.02, 0.01])
    tips = allegro.fingertips(allegro.default_position)
    # The final map closes no pinch; the hand and the lattices are those of each step's own map.
    thumb = allegro.description.fingers[0]
    gaps = np.linalg.norm(tips[1:] - tips[0], axis=1)
    assert closed[-1] == (gaps.min() <= 2 * allegro.tip_radius)
    _, lattices = read(path, f"/world/robot/lattice/{thumb.name}", "LineStrips3D:strips", timeline="step")
    np.testing.assert_allclose(lattices[-1], np.broadcast_to(tips[0], lattices[-1].shape), atol=1e-6)
    network.load_state_dict(kept[0])
    lattice = scene.Lattice(play.fingertips(allegro.description.human_keypoints), 0)
    with torch.no_grad():
        q = network(torch.tensor(lattice.hands, dtype=torch.float32)).numpy().astype(float)
    np.testing.assert_allclose(lattices[0], lattice.segments(allegro.fingertips(q)[:, 0]), atol=1e-5)
