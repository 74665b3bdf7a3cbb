"""Times the Rerun recorder and measures the size of its files.

python benchmarks/bench_recorder.py --json recorder.json

Free bodies are simulated and recorded at 60 Hz: all in the air, a third of them rolling on the ground with a
contact each (a few more contacts than in a grasp), and all of them rolling. The cost of a frame is its sample
and its share of writing the file, in CPU time of the thread.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from rich.table import Table
from side_by_side import parse, parser, write_json

from geort_drake import add_rerun_recorder
from geort_drake.console import console, run_main

PERIOD = 1 / 60  # s
RADIUS = 0.05  # m
HEIGHT = 1e5  # m; bodies that fall from this height stay in the air
FIGURES = {
    "contacts": "{:.0f}",
    "sample_ms": "{:.3f}",
    "writing_ms": "{:.3f}",
    "frame_ms": "{:.3f}",
    "mb_per_minute": "{:.1f}",
    "models_mb": "{:.2f}",
}


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    options.add_argument("--bodies", type=int, default=30, help="number of bodies (default: %(default)s)")
    options.add_argument("--repeats", type=int, default=3, help="repeats, for medians (default: %(default)s)")
    arguments = parse(options, argv)
    rolling = {
        "in the air": 0,
        "a third on the ground": arguments.bodies // 3,
        "on the ground": arguments.bodies,
    }
    rows = {name: _figures(arguments, count) for name, count in rolling.items()}
    table = Table("", *(figure.replace("_", " ") for figure in FIGURES))  # headings wrap at spaces
    for name, row in rows.items():
        table.add_row(name, *(form.format(row[figure]) for figure, form in FIGURES.items()))
    console.print(table)
    if arguments.json:
        write_json(arguments.json, bodies=arguments.bodies, seconds=arguments.seconds, results=rows)
    return 0


def _figures(arguments: argparse.Namespace, rolling: int) -> dict[str, float]:
    """Returns medians over the repeats."""
    frames = round(arguments.seconds / PERIOD) + 1
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bodies.rrd"
        *_, models = _record(arguments.bodies, rolling, 1, path)
        rows = [_record(arguments.bodies, rolling, frames, path) for _ in range(arguments.repeats)]
    sampling, writing, contacts, megabytes = np.median(rows, axis=0)
    return {
        "contacts": contacts,
        "sample_ms": 1e3 * sampling / frames,
        "writing_ms": 1e3 * writing / frames,
        "frame_ms": 1e3 * (sampling + writing) / frames,
        "mb_per_minute": (megabytes - models) / (frames * PERIOD / 60),
        "models_mb": models,
    }


def _record(bodies: int, rolling: int, frames: int, path: Path) -> tuple[float, float, int, float]:
    """Returns CPU seconds of sampling and of writing, final number of contacts, and megabytes written."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=PERIOD)
    friction = CoulombFriction(0.5, 0.5)
    if rolling:
        X_WG = RigidTransform([0, 0, -0.05])
        plant.RegisterCollisionGeometry(plant.world_body(), X_WG, Box(500, 500, 0.1), "ground", friction)
    inertia = SpatialInertia.SolidSphereWithMass(0.1, RADIUS)
    for i in range(bodies):
        body = plant.AddRigidBody(f"body_{i}", inertia)
        plant.RegisterVisualGeometry(body, RigidTransform(), Sphere(RADIUS), "skin", [0.8, 0.5, 0.2, 1])
        plant.RegisterCollisionGeometry(body, RigidTransform(), Sphere(RADIUS), "solid", friction)
    plant.Finalize()
    for i, body in enumerate(map(plant.GetBodyByName, [f"body_{i}" for i in range(bodies)])):
        p_WB = [0.3 * (i % 6), 0.3 * (i // 6), RADIUS if i < rolling else HEIGHT]
        plant.SetDefaultFloatingBaseBodyPose(body, RigidTransform(p_WB))
    # Samples are forced, so that nothing else is timed.
    recorder = add_rerun_recorder(builder, plant, scene_graph, path, period=2 * frames * PERIOD)
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetVelocities(context, np.tile([1.1, 1.2, 0, 0.3, 0.2, 0], bodies))
    own = recorder.GetMyContextFromRoot(simulator.get_context())
    sampling = 0.0
    for frame in range(frames):
        simulator.AdvanceTo(frame * PERIOD)
        started = time.thread_time()
        recorder.ForcedPublish(own)
        sampling += time.thread_time() - started
    contacts = plant.get_contact_results_output_port().Eval(context).num_point_pair_contacts()
    started = time.thread_time()
    recorder.close()
    return sampling, time.thread_time() - started, contacts, path.stat().st_size / 1e6


if __name__ == "__main__":
    run_main(main)
