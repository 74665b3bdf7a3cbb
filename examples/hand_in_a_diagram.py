"""A recording drives a robot hand in a Drake diagram of your own."""

from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from geort_drake import (
    GloveReplay,
    HandSpec,
    RetargetingSystem,
    add_hand_model,
    add_rerun_recorder,
    load_hand,
    load_retargeter,
    synthesize_play,
)

hand = load_hand("allegro_right")
builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.002)
model = add_hand_model(plant, hand)
plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(hand.base_frame, model))
plant.set_gravity_enabled(model, False)
plant.Finalize()

# The glove's keypoints become joint targets, in the plant's actuator order.
retarget = load_retargeter("allegro_right")
replay = builder.AddSystem(GloveReplay(synthesize_play(seed=1, duration_s=5.0)))
retargeting = builder.AddSystem(RetargetingSystem(retarget, plant, model))
builder.Connect(replay.GetOutputPort("keypoints"), retargeting.GetInputPort("keypoints"))
builder.Connect(replay.GetOutputPort("valid"), retargeting.GetInputPort("valid"))
builder.Connect(retargeting.GetOutputPort("desired_state"), plant.get_desired_state_input_port(model))

human = HandSpec(*(replay.GetOutputPort(name) for name in ("keypoints", "wrist_pose", "valid")))
recorder = add_rerun_recorder(builder, plant, scene_graph, "play.rrd", {"human": human})
simulator = Simulator(builder.Build())
with recorder:
    simulator.AdvanceTo(5.0)
