"""A Rerun recording of a training: how the map from a human to a robot hand forms, step by step."""

import copy
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from geort_drake.comparison.training_scene import CRITERIA, Map, TrainingScene
from geort_drake.hands.model import HandModel
from geort_drake.people.recording import Recording
from geort_drake.rerun import blueprint as views
from geort_drake.rerun.streams import Property, file_writer
from geort_drake.rerun.writer import PALETTE, STEPS

APPLICATION = "geort_drake_training"
_PLAYING_TIME = 10.0  # s
_TEXT = """\
**{method}** learns to move the {hand}; no robot pose is given for any human pose. Flat lattices lie among the
person's fingertips; the map carries them over.

| | the map should | look at |
|---|---|---|
| I | keep directions | lattices keep theirs |
| II | use the whole reach | grey dots take a colour |
| III | be even | lattice cells are alike |
| IV | close pinches | red lines turn green |
| V | not hit itself | red balls vanish |

Plots: I cosine; II, IV and V shares; III 0 where it is even. Both hands show one pinch of the recording.
"""
# Title, eye, what it looks at (m, in W), and entities of each view.
_VIEWS = (
    ("the person's fingertips", (0.19, 0.18, 0.17), (0.03, 0.01, 0.1), ["/world/human/**"]),
    (
        "what the map makes of them: I, III, IV, V",
        (0.22, 0.53, 0.19),
        (0.04, 0.33, 0.11),
        ["/world/robot/**", "- /world/robot/reach/**"],
    ),
    (
        "the robot's reach: II",
        (0.35, 0.48, 0.21),
        (0.04, 0.34, 0.11),
        [
            "/world/robot/**",
            "- /world/robot/lattice/**",
            "- /world/robot/pinches",
            "- /world/robot/collisions",
        ],
    ),
)


class TrainingRecorder:
    """Records a training: pass `observe` to the trainer as its `Report`; `write` makes the recording.

    Observing only copies the weights; everything else is computed by `write`.

    Args:
        hand: model of the robot hand.
        recording: what the map is trained on.
        seed: of the samples for the figures.
    """

    def __init__(self, hand: HandModel, recording: Recording, seed: int = 0):
        self._hand, self._recording, self._seed = hand, recording, seed
        self._network: torch.nn.Module | None = None
        self._weights: dict[int, dict[str, torch.Tensor]] = {}
        self._losses: list[dict[str, float]] = []
        self._steps = 0

    def observe(self, step: int, steps: int, losses: dict[str, float], network: torch.nn.Module) -> None:
        """Keeps the state of a training; the network maps fingertips (N, F, 3), m, to joint angles (N, n)."""
        if self._network is None:
            self._network = copy.deepcopy(network).cpu()
        self._steps = steps
        self._losses.append(losses)
        if step < steps:
            weights = network.state_dict().items()
            self._weights[step] = {name: value.detach().cpu().clone() for name, value in weights}

    def write(self, path: str | os.PathLike, trained: Map, properties: Mapping[str, Property]) -> None:
        """Writes what was observed, with the criteria measured at every observed step.

        Args:
            path: .rrd to write.
            trained: the final map, shown last.
            properties: what the recording is about; must hold `method`, `hand` and `seed`.
        """
        maps = {step: self._map(weights) for step, weights in self._weights.items()} | {self._steps: trained}
        names = [name for name in self._losses[0] if name not in ("step", "seconds", "total")]
        losses = np.array([[line[name] for name in names] for line in self._losses])
        id = "-".join(str(properties[key]) for key in ("method", "hand", "seed"))
        with file_writer(
            Path(path),
            application_id=APPLICATION,
            recording_id=f"training-{id}-{self._recording.digest}",
            blueprint=_blueprint(self._steps, losses),
            properties=properties,
            timeline=STEPS,
        ) as writer:
            writer.text("/about", _TEXT.format(**properties))
            writer.at(np.array([line["step"] for line in self._losses], dtype=np.int64))
            for i, name in enumerate(names):
                writer.series(f"/losses/{name}", [name], losses[:, [i]], PALETTE[i % len(PALETTE) :], 1.5)
            writer.at(np.array(list(maps), dtype=np.int64))
            TrainingScene(self._hand, self._recording, self._seed).write(writer, list(maps.values()))

    def _map(self, weights: Mapping[str, torch.Tensor]) -> Map:
        def answer(p_HF: np.ndarray) -> np.ndarray:
            network = self._network
            assert network is not None
            network.load_state_dict(weights)
            with torch.no_grad():
                return network(torch.tensor(p_HF, dtype=torch.float32)).numpy().astype(float)

        return answer


def _blueprint(steps: int, losses: np.ndarray) -> Any:
    """The layout for so many steps and losses (observations, losses)."""
    scenes = [views.scene_view(eye, target, title, contents) for title, eye, target, contents in _VIEWS]
    criteria = [
        views.time_series(title, [f"/criteria/{key}"], steps=steps, limits=limits)
        for key, (title, limits) in CRITERIA.items()
    ]
    # The highest peaks are cut, as they would flatten everything else.
    low, high = np.percentile(losses, [0, 97])
    margin = 0.05 * max(high - low, 1e-6)
    # The axis is longer than the training, to leave room for the legend.
    shown = round(1.7 * steps), (low - margin, high + margin)
    below = views.row(
        views.text_view("/about", "what you see"),
        views.column(views.row(*criteria[:3]), views.row(*criteria[3:]), name="criteria"),
        views.time_series("losses", ["/losses/**"], "right", *shown),
        shares=[4, 6, 4],
    )
    layout = views.column(views.row(*scenes), below, shares=[5, 4])
    return views.blueprint(layout, STEPS, max(steps / _PLAYING_TIME, 1.0))
