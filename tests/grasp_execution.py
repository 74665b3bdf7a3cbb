"""Carries out a planned grasp without operator and retargeter: close, squeeze, lift.

The hand base stands where the goal puts it, on a lift, and the fingertips are led by inverse kinematics.
"""

import dataclasses as dc

import numpy as np
from affine_map import AffineMap
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, RigidBody, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.model import HandModel
from geort_drake.resources import models_dir, resolve_uri
from geort_drake.simulation.object_shape import object_shape
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.world import add_object, standing_pose

# Times since the start, s: the fingertips are at the surface, squeezed, settled, and lifted; end of the hold.
TOUCHED, SQUEEZED, SETTLED, RAISED, END = 0.8, 1.2, 1.4, 2.2, 3.0
LIFT = 0.15


@dc.dataclass(frozen=True)
class Execution:
    """What came of it."""

    # Lowest point of the object over its support at the end, m.
    height: float
    # How far the object moved in the hand while it was lifted and held, m.
    slip: float
    # Force between each finger, then the palm, and the object at the end, N.
    force: np.ndarray


def execute(
    scenario: Scenario,
    hand: HandModel,
    goal: GraspGoal,
    squeeze: float,
    offset: np.ndarray | None = None,
    mass_factor: float = 1.0,
) -> Execution:
    """Simulates the goal's grasp.

    Args:
        squeeze: how far below the surface the fingertips are asked to go, m.
        offset: how far the hand is from where it should be, (3,) m in W.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
    Parser(plant).AddModels(models_dir() / "sdf" / "plinth.sdf")
    x, y = scenario.object.position
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("plinth_base"), RigidTransform([x, y, 0]))
    (model,) = Parser(plant, "hand").AddModels(resolve_uri(hand.description.model))
    thing = add_object(plant, scenario.object.name)
    shape = object_shape(plant, scene_graph.model_inspector(), thing)
    X_WO = standing_pose(scenario, shape.lowest_point(RigidTransform()), 0, 0, 0)
    X_WB = RigidTransform(np.zeros(3) if offset is None else offset) @ X_WO @ goal.X_OB
    lift = _mount_on_lift(plant, plant.GetFrameByName(hand.description.base_frame, model), X_WB)
    plant.set_gravity_enabled(model, False)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, thing, X_WO)
    M = thing.CalcSpatialInertiaInBodyFrame(context)
    thing.SetSpatialInertiaInBodyFrame(
        context, SpatialInertia(mass_factor * M.get_mass(), M.get_com(), M.get_unit_inertia())
    )

    X_BO = goal.X_OB.inverse()

    def fingertips(depth: float) -> np.ndarray:
        return X_BO.multiply((goal.p_OF_touch + depth * goal.n_OF).T).T

    rest = hand.fingertips(hand.default_position)
    follow = AffineMap(hand, rest)
    for share in np.linspace(0, 1, 50):
        q = follow(rest + share * (goal.p_BF_open - rest))
    for name, angle in zip(hand.joint_names, q, strict=True):
        plant.GetJointByName(name, model).set_angle(context, angle)
    port = plant.get_desired_state_input_port(model)
    actuated = [plant.get_joint_actuator(i).joint().name() for i in plant.GetJointActuatorIndices(model)]
    order = [hand.joint_names.index(name) for name in actuated]
    lift_port = plant.get_desired_state_input_port(lift.model_instance())
    at_rest = None
    for t in np.arange(0, END, 0.01):
        if t < TOUCHED:
            p_BF = goal.p_BF_open + t / TOUCHED * (fingertips(0.0) - goal.p_BF_open)
        else:
            p_BF = fingertips(squeeze * min((t - TOUCHED) / (SQUEEZED - TOUCHED), 1.0))
        q = follow(p_BF)
        port.FixValue(context, np.concatenate([q[order], np.zeros(len(order))]))
        raised = LIFT * np.clip((t - SETTLED) / (RAISED - SETTLED), 0, 1)
        lift_port.FixValue(context, [raised, LIFT / (RAISED - SETTLED) if 0 < raised < LIFT else 0.0])
        if t >= SETTLED and at_rest is None:
            at_rest = _pose_in_hand(plant, context, model, hand, thing)
        simulator.AdvanceTo(t + 0.01)
    assert at_rest is not None
    X_now = plant.EvalBodyPoseInWorld(context, thing)
    change = at_rest.inverse() @ _pose_in_hand(plant, context, model, hand, thing)
    return Execution(
        height=shape.lowest_point(X_now) - scenario.object.support_height,
        slip=float(np.linalg.norm(change.translation())),
        force=_forces(plant, context, model, hand, thing),
    )


def _mount_on_lift(plant, frame, X_WB: RigidTransform) -> PrismaticJoint:
    """A carriage that moves along the world's z and carries `frame` at X_WB when it is down."""
    model = plant.AddModelInstance("lift")
    carriage = plant.AddRigidBody(
        "carriage", model, SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.1))
    )
    lift = plant.AddJoint(PrismaticJoint("lift", plant.world_frame(), carriage.body_frame(), [0, 0, 1]))
    actuator = plant.AddJointActuator("lift", lift)
    actuator.set_controller_gains(PdControllerGains(p=1e5, d=1e3))
    plant.set_gravity_enabled(model, False)
    plant.WeldFrames(carriage.body_frame(), frame, X_WB)
    return lift


def _pose_in_hand(plant, context, model, hand: HandModel, thing: RigidBody) -> RigidTransform:
    base = plant.GetFrameByName(hand.description.base_frame, model)
    return base.CalcPoseInWorld(context).inverse() @ plant.EvalBodyPoseInWorld(context, thing)


def _forces(plant, context, model, hand: HandModel, thing: RigidBody) -> np.ndarray:
    """Sum of the contact forces' magnitudes between each finger, then the palm, and the object, N."""
    part = {plant.GetFrameByName(hand.description.base_frame, model).body().index(): -1}
    for number, finger in enumerate(hand.description.fingers):
        for name in finger.joints:
            part[plant.GetJointByName(name, model).child_body().index()] = number
    force = np.zeros(len(hand.description.fingers) + 1)
    results = plant.get_contact_results_output_port().Eval(context)
    for number in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(number)
        pair = (info.bodyA_index(), info.bodyB_index())
        if thing.index() in pair:
            other = pair[0] if pair[1] == thing.index() else pair[1]
            if other in part:
                force[part[other]] += np.linalg.norm(info.contact_force())
    return force
