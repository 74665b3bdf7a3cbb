"""A live glove drives a robot hand in a Drake diagram of your own, which Meshcat shows."""

from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.visualization import AddDefaultVisualization

from geort_drake import RetargetingSystem, add_hand_model, load_hand, load_retargeter
from geort_drake.live.glove_stream import GloveStream, open_glove

hand = load_hand("allegro_right")
builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.002)
model = add_hand_model(plant, hand)
plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(hand.base_frame, model))
# The controllers of a real hand compensate gravity; here the fingers would sag by torque over stiffness.
plant.set_gravity_enabled(model, False)
plant.Finalize()

# Frames arrive over ZeroMQ, from your glove or, to try it, from: geort-drake live publish hand.npz --loop
glove = builder.AddSystem(GloveStream(open_glove("sub+tcp://127.0.0.1:5556", "right")))
# The plant tells the joints' order, limits and start.
retargeting = builder.AddSystem(RetargetingSystem(load_retargeter("allegro_right"), plant, model))
for name in ("keypoints", "valid"):
    builder.Connect(glove.GetOutputPort(name), retargeting.GetInputPort(name))
builder.Connect(retargeting.GetOutputPort("desired_state"), plant.get_desired_state_input_port(model))
AddDefaultVisualization(builder)  # prints the address of the page

simulator = Simulator(builder.Build())
simulator.set_target_realtime_rate(1.0)
simulator.AdvanceTo(5.0)
context = retargeting.GetMyContextFromRoot(simulator.get_context())
print(retargeting.GetOutputPort("status").Eval(context).state)
