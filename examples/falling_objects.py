"""Records objects that fall into a box, and their contact forces."""

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from geort_drake import add_rerun_recorder

OBJECTS = "package://drake/examples/kuka_iiwa_arm/models/objects"
builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.001)
parser = Parser(plant)
parser.SetAutoRenaming(True)
parser.AddModels(url=f"{OBJECTS}/open_top_box.urdf")
plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("bin"))
names = ["block_for_pick_and_place", "simple_cylinder"] * 3
falling = [parser.AddModels(url=f"{OBJECTS}/{name}.urdf")[0] for name in names]
plant.Finalize()

rng = np.random.default_rng(1)
for number, model in enumerate(falling):
    (body,) = (plant.get_body(index) for index in plant.GetBodyIndices(model))
    p_WB = [*rng.uniform(-0.06, 0.06, 2), 0.2 + 0.12 * number]
    plant.SetDefaultFloatingBaseBodyPose(body, RigidTransform(RollPitchYaw(rng.uniform(-1, 1, 3)), p_WB))

# From above, because the box has walls.
view_from = (0.35, -0.35, 0.75)
recorder = add_rerun_recorder(builder, plant, scene_graph, "objects.rrd", view_from=view_from)
simulator = Simulator(builder.Build())
with recorder:
    simulator.AdvanceTo(1.0)
