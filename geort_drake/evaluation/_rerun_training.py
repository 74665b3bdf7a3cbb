"""A training as a recording: how the map from a human to a robot hand forms, step by step."""

import contextlib
import copy
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import torch
from torch.nn.modules.module import register_module_module_registration_hook
from torch.optim.optimizer import register_optimizer_step_pre_hook

from geort_drake.evaluation._rerun_training_scene import CRITERIA, Map, TrainingScene
from geort_drake.gloves.recording import Recording
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.networks import RetargetingNetwork
from geort_drake.systems._rerun_blueprint import blueprint, scene_view, time_series
from geort_drake.systems._rerun_tracks import PALETTE, scalars
from geort_drake.systems._rerun_writer import STEPS, Property, Writer, file_writer

APPLICATION = "geort_drake_training"
_TEXT = """\
**{method}** learns to move the {hand} from a recording of a person's hand. Nobody shows it which robot pose
belongs to which human one. Left: where the person's fingertips were, with a lattice drawn through each cloud.
Right: where the robot's fingertips can be, and **the same lattice, carried over by the map** at this step.
Move through the steps to see the five criteria at work:

| | asks that | look at |
|---|---|---|
| I | the robot's fingertip moves where the human one does | the lattices keep their directions |
| II | the robot uses all its reach | grey dots take their finger's colour within 10 mm of the map |
| III | equal motions are answered equally | the lattice's cells become alike |
| IV | pinches close | lines between robot fingertips, red while open, green when they meet |
| V | the hand does not hit itself | red balls vanish |

Both hands show one instant of the recording, a pinch. The curves are measured on a sample of it.
"""


class TrainingRecorder:
    """Looks on while a map is trained, by its callback `observe`; `write` makes the recording.

    Observing only copies the weights; all that is drawn and measured is worked out by `write`.

    Args:
        hand: model of the robot hand.
        recording: what the map is trained on.
        seed: of what is sampled for the figures.
    """

    def __init__(self, hand: HandModel, recording: Recording, seed: int = 0):
        self._hand, self._recording, self._seed = hand, recording, seed
        self._network: torch.nn.Module | None = None
        self._weights: list[tuple[int, dict[str, torch.Tensor]]] = []

    def observe(self, step: int, network: torch.nn.Module) -> None:
        """Keeps the weights of the network, which maps fingertips (N, F, 3), m, to joint angles (N, n)."""
        if self._network is None:
            self._network = copy.deepcopy(network).cpu()
        weights = {name: value.detach().cpu().clone() for name, value in network.state_dict().items()}
        self._weights.append((step, weights))

    @contextlib.contextmanager
    def looking_on(self, steps: int, times: int = 60) -> Iterator[None]:
        """Observes the first retargeting network that is made inside the block, `times` times in `steps`.

        It needs no help from the trainer: torch says when a network is made, and when it is about to learn.
        """
        interval, step = max(steps // times, 1), 0
        network: RetargetingNetwork | None = None

        def made(module: torch.nn.Module, _name: str, _part: torch.nn.Module | None) -> None:
            nonlocal network
            if network is None and isinstance(module, RetargetingNetwork):
                network = module

        def learns(optimiser: torch.optim.Optimizer, _args, _kwargs) -> None:
            nonlocal step
            if network is None:
                return
            first = next(network.parameters())
            if any(first is parameter for group in optimiser.param_groups for parameter in group["params"]):
                if step % interval == 0:
                    self.observe(step, network)
                step += 1

        hooks = [register_module_module_registration_hook(made), register_optimizer_step_pre_hook(learns)]
        try:
            yield
        finally:
            for hook in hooks:
                hook.remove()

    def write(
        self,
        path: str | os.PathLike,
        trained: Map,
        losses: Sequence[Mapping[str, float]],
        properties: Mapping[str, Property],
    ) -> None:
        """Writes what was observed, with the criteria measured at every observed step.

        Args:
            path: .rrd to write.
            trained: the map that remained; it is shown last.
            losses: rows with a "step" each.
            properties: what the recording is about; `method`, `hand` and `seed` are needed.
        """
        observed: list[tuple[int, Map]] = [(step, self._map(weights)) for step, weights in self._weights]
        last = 1 + int(max([step for step, _ in observed] + [row["step"] for row in losses], default=0))
        observed.append((last, trained))
        name = "-".join(str(properties[key]) for key in ("method", "hand", "seed"))
        with file_writer(
            Path(path),
            application_id=APPLICATION,
            recording_id=f"training-{name}-{self._recording.digest}",
            blueprint=_layout(last),
            properties=properties,
            timeline=STEPS,
        ) as writer:
            if writer is None:
                return
            text = _TEXT.format(**properties)
            writer.static("/about", rr.TextDocument(text, media_type="text/markdown"))
            _write_losses(writer, losses)
            writer.at(np.array([step for step, _ in observed], dtype=np.int64))
            scene = TrainingScene(self._hand, self._recording, self._seed)
            scene.write(writer, [answer for _, answer in observed])

    def _map(self, weights: Mapping[str, torch.Tensor]) -> Map:
        def answer(p_HF: np.ndarray) -> np.ndarray:
            network = self._network
            assert network is not None
            network.load_state_dict(weights)
            with torch.no_grad():
                return network(torch.tensor(p_HF, dtype=torch.float32)).numpy().astype(float)

        return answer


def _write_losses(writer: Writer, losses: Sequence[Mapping[str, float]]) -> None:
    if not losses:
        return
    writer.at(np.array([row["step"] for row in losses], dtype=np.int64))
    names = [name for name in losses[0] if name not in ("step", "seconds", "total")]
    for number, name in enumerate(names):
        path, color = f"/losses/{name}", PALETTE[number % len(PALETTE)]
        writer.static(path, rr.SeriesLines(names=[name], colors=[color], widths=[1.5]))
        writer.columns(path, scalars(np.array([[row[name]] for row in losses])))


def _layout(steps: int) -> rrb.Blueprint:
    scene = scene_view((0.72, 0.16, 0.3), (0.0, 0.16, 0.1), "human and robot fingertip space")
    plots = [time_series(title, [f"/criteria/{key}"], legend=False) for key, title in CRITERIA.items()]
    right = rrb.Vertical(
        rrb.TextDocumentView(origin="/about", name="what you see"),
        rrb.Grid(contents=[*plots, time_series("losses", ["/losses/**"])], grid_columns=2, name="criteria"),
        row_shares=[1.0, 1.5],
    )
    # All of it within ten seconds.
    return blueprint(rrb.Horizontal(scene, right, column_shares=[3, 2]), STEPS, max(steps / 10, 1.0))
