"""A small world for tests of the recorder, and a reader of the files that it writes; no tests."""

import subprocess
import sys
from pathlib import Path

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from rerun.chunk import RrdReader

from geort_drake import add_rerun_recorder

GRAVITY = 9.81
MASS = 0.2  # kg, of the ball

SDF = Path(__file__).with_suffix(".sdf").read_text("utf-8")
HYDROELASTIC = """<drake:proximity_properties><drake:compliant_hydroelastic/>
  <drake:hydroelastic_modulus>1e6</drake:hydroelastic_modulus>
  <drake:mesh_resolution_hint>0.02</drake:mesh_resolution_hint></drake:proximity_properties>"""


class World:
    """A ball above the ground and a loose arm; further systems may be added before `record`."""

    def __init__(self, height=0.5, contact_model="point"):
        self.builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=0.002, contact_model=contact_model)
        self.plant, self.scene_graph = AddMultibodyPlant(config, self.builder)
        hydroelastic = HYDROELASTIC if contact_model == "hydroelastic" else ""
        sdf = SDF.replace("<!-- hydroelastic -->", hydroelastic)
        Parser(self.plant).AddModelsFromString(sdf, "sdf")
        self.ball = self.plant.GetBodyByName("body")
        self.upper = self.plant.GetBodyByName("upper")
        self.height = height

    def finalize(self):
        self.plant.Finalize()
        self.plant.SetDefaultFloatingBaseBodyPose(self.ball, RigidTransform([0, 0, self.height]))
        return self

    def record(self, path, until=None, **options):
        """Adds the recorder; with `until`, simulates to that time (s) and writes the file."""
        self.recorder = add_rerun_recorder(self.builder, self.plant, self.scene_graph, path, **options)
        self.simulator = Simulator(self.builder.Build())
        root = self.simulator.get_mutable_context()
        self.context = self.plant.GetMyMutableContextFromRoot(root)
        if until is not None:
            with self.recorder:
                self.simulator.AdvanceTo(until)
        return self

    def kick(self, speed):
        """Sets the ball's upward velocity, m/s."""
        velocities = self.plant.GetVelocities(self.context).copy()
        # Angular velocity, then linear; its z comes last of six.
        velocities[self.ball.floating_velocities_start_in_v() + 5] = speed
        self.plant.SetVelocities(self.context, velocities)


def constant(builder, values):
    return builder.AddSystem(ConstantVectorSource(np.array(values, float))).get_output_port()


def steps(builder, times, values):
    trajectory = PiecewisePolynomial.ZeroOrderHold(times, np.atleast_2d(np.array(values, float)))
    return builder.AddSystem(TrajectorySource(trajectory)).get_output_port()


def pose_source(builder, X):
    return builder.AddSystem(ConstantValueSource(AbstractValue.Make(X))).get_output_port()


def rerun(*arguments):
    command = [sys.executable, "-m", "rerun", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def read(path, entity, component, timeline="sim_time"):
    """Times (s, or steps; None for static data) and one array per time of a component in a file."""
    times, values = [], []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        static = timeline not in batch.schema.names
        stamps = [None] * chunk.num_rows if static else batch.column(timeline).cast("int64").to_pylist()
        unit = 1e-9 if timeline == "sim_time" else 1
        times += [None if stamp is None else stamp * unit for stamp in stamps]
        values += [np.array(row) for row in batch.column(component).to_pylist()]
    assert values, f"{entity} has no {component}"
    return times, values


def entities(path):
    return {chunk.entity_path for chunk in RrdReader(path).stream()}
