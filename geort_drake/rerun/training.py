"""A training as a recording: how the map from a human to a robot hand forms, step by step."""

import copy
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import torch

from geort_drake.hands.model import HandModel
from geort_drake.people.recording import Recording
from geort_drake.rerun.blueprint import blueprint, scene_view, time_series
from geort_drake.rerun.tracks import PALETTE, scalars
from geort_drake.rerun.training_scene import CRITERIA, Map, TrainingScene
from geort_drake.rerun.writer import STEPS, Property, Writer, file_writer

APPLICATION = "geort_drake_training"
_TEXT = """\
**{method}** learns to move the {hand}; nobody shows it which robot pose belongs to which human one. Lattices
lie flat among the person's fingertips; the map carries them over.

| | the map should | look at |
|---|---|---|
| I | keep directions | lattices keep theirs |
| II | use the whole reach | grey dots take a colour |
| III | be even | lattice cells are alike |
| IV | close pinches | red lines turn green |
| V | not hit itself | red balls vanish |

Plots: I cosine; II, IV and V shares; III 0 where it is even. Both hands show one pinch of the recording.
"""
# Title, where the eye is, what it looks at (m, in W), and which entities are there.
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
    """Looks on while a map is trained: `observe` is the trainer's `Report`; `write` makes the recording.

    Observing only copies the weights; all that is drawn and measured is worked out by `write`.

    Args:
        hand: model of the robot hand.
        recording: what the map is trained on.
        seed: of what is sampled for the figures.
    """

    def __init__(self, hand: HandModel, recording: Recording, seed: int = 0):
        self._hand, self._recording, self._seed = hand, recording, seed
        self._network: torch.nn.Module | None = None
        self._weights: dict[int, dict[str, torch.Tensor]] = {}
        self._losses: list[dict[str, float]] = []
        self._steps = 0

    def observe(self, step: int, steps: int, losses: dict[str, float], network: torch.nn.Module) -> None:
        """Keeps what a `Report` is told; the network maps fingertips (N, F, 3), m, to joint angles (N, n)."""
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
            trained: the map that remained; it is shown last.
            properties: what the recording is about; `method`, `hand` and `seed` are needed.
        """
        maps = {step: self._map(weights) for step, weights in self._weights.items()} | {self._steps: trained}
        name = "-".join(str(properties[key]) for key in ("method", "hand", "seed"))
        with file_writer(
            Path(path),
            application_id=APPLICATION,
            recording_id=f"training-{name}-{self._recording.digest}",
            blueprint=_layout(self._steps, self._loss_range()),
            properties=properties,
            timeline=STEPS,
        ) as writer:
            if writer is None:
                return
            text = _TEXT.format(**properties)
            writer.static("/about", rr.TextDocument(text, media_type="text/markdown"))
            self._write_losses(writer)
            writer.at(np.array(list(maps), dtype=np.int64))
            scene = TrainingScene(self._hand, self._recording, self._seed)
            scene.write(writer, list(maps.values()))

    def _write_losses(self, writer: Writer) -> None:
        writer.at(np.array([row["step"] for row in self._losses], dtype=np.int64))
        for number, name in enumerate(self._loss_names()):
            path, color = f"/losses/{name}", PALETTE[number % len(PALETTE)]
            writer.static(path, rr.SeriesLines(names=[name], colors=[color], widths=[1.5]))
            writer.columns(path, scalars(np.array([[row[name]] for row in self._losses])))

    def _loss_names(self) -> list[str]:
        return [name for name in self._losses[0] if name not in ("step", "seconds", "total")]

    def _loss_range(self) -> tuple[float, float]:
        """From the lowest to what only the peaks of some are above, which would flatten the others."""
        names = self._loss_names()
        values = np.array([[row[name] for name in names] for row in self._losses])
        low, high = np.percentile(values, [0, 97])
        margin = 0.05 * max(high - low, 1e-6)
        return low - margin, high + margin

    def _map(self, weights: Mapping[str, torch.Tensor]) -> Map:
        def answer(p_HF: np.ndarray) -> np.ndarray:
            network = self._network
            assert network is not None
            network.load_state_dict(weights)
            with torch.no_grad():
                return network(torch.tensor(p_HF, dtype=torch.float32)).numpy().astype(float)

        return answer


_WITH_LEGEND = 1.7  # a plot's time axis is so much longer than the training, so that a legend has room


def _layout(steps: int, losses: tuple[float, float]) -> rrb.Blueprint:
    """Of a training of so many steps, with a plot of losses from lowest to highest."""
    scenes = [scene_view(eye, target, title, contents) for title, eye, target, contents in _VIEWS]
    plots = [
        time_series(title, [f"/criteria/{key}"], steps=steps, limits=limits)
        for key, (title, limits) in CRITERIA.items()
    ]
    below = rrb.Horizontal(
        rrb.TextDocumentView(origin="/about", name="what you see"),
        rrb.Vertical(rrb.Horizontal(*plots[:3]), rrb.Horizontal(*plots[3:]), name="criteria"),
        time_series("losses", ["/losses/**"], rrb.Corner2D.RightTop, round(_WITH_LEGEND * steps), losses),
        column_shares=[4, 6, 4],
    )
    rows = rrb.Vertical(rrb.Horizontal(*scenes), below, row_shares=[5, 4])
    # All of it within ten seconds.
    return blueprint(rows, STEPS, max(steps / 10, 1.0))
