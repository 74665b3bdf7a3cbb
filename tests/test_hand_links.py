"""Links of fingers and palm of a hand with followers, and contacts on them."""

import numpy as np
import pytest
from hand_family import HandSpec, write_hand
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder

from geort_drake import HandModel, load_scenario
from geort_drake.hands.assembly import add_hand_model
from geort_drake.hands.chains import finger_links, palm_links
from geort_drake.hands.description import CouplingDescription, HandDescription, load_hand
from geort_drake.hands.importers.proposal import propose
from geort_drake.simulation.world import add_object, add_scene
from geort_drake.systems.scene_view import SceneView


@pytest.fixture
def description(tmp_path) -> HandDescription:
    """Three fingers; one motor of the index moves three links, two of them followers."""
    hand = propose(write_hand(tmp_path, HandSpec(3))).description
    index = hand.fingers[1]
    index.joints.remove("index_j2")
    hand.couplings.append(CouplingDescription("index_j2", "index_j1", 0.5))
    return hand


def _plant(description: HandDescription, object_name: str = "sphere"):
    """The hand with its base at the world's origin, and an object beside it."""
    builder = DiagramBuilder()
    # Ports that are not sampled show contacts before the first step.
    config = MultibodyPlantConfig(
        time_step=0.002, discrete_contact_approximation="sap", use_sampled_output_ports=False
    )
    plant, _ = AddMultibodyPlant(config, builder)
    hand = add_hand_model(plant, description, "hand")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(description.base_frame, hand))
    thing = add_object(plant, object_name)
    plant.Finalize()
    return builder, plant, hand, thing


def _view(builder, plant, description: HandDescription, hand, thing) -> SceneView:
    """The view of hand and object."""
    scene_graph = builder.GetSubsystemByName("scene_graph")
    view = builder.AddSystem(
        SceneView(plant, description, hand, thing.index(), scene_graph.model_inspector())
    )
    builder.Connect(plant.get_body_poses_output_port(), view.GetInputPort("body_poses"))
    builder.Connect(plant.get_contact_results_output_port(), view.GetInputPort("contact_results"))
    return view


def test_a_finger_has_all_links_that_its_motors_move(description):
    """Including followers; held links belong to the palm."""
    description.fingers[2].joints.remove("middle_j0")
    _, plant, hand, _ = _plant(description)
    names = [[body.name() for body in links] for links in finger_links(plant, description, hand)]
    assert names[0] == [f"thumb_l{i}" for i in range(3)]
    assert names[1] == [f"index_l{i}" for i in range(4)]
    assert names[2] == [f"middle_l{i}" for i in range(1, 4)]
    assert [body.name() for body in palm_links(plant, description, hand)] == ["palm", "middle_l0"]


@pytest.mark.parametrize("link", ["index_l1", "index_l2", "index_l3"])
def test_contact_on_a_follower_counts_for_its_finger(description, link):
    """An object that overlaps one link of the index is in contact with the index alone."""
    builder, plant, hand, thing = _plant(description)
    view = _view(builder, plant, description, hand, thing)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    # Beside the middle of the link, on the thumb's side, where no other finger is.
    middle = plant.GetBodyByName(link, hand).EvalPoseInWorld(context).translation() + [0, 0, 0.01]
    plant.SetFloatingBaseBodyPoseInWorldFrame(
        context, thing, RigidTransform(middle + np.array([0.0, 0.033, 0.0]))
    )
    contact = view.GetOutputPort("contact").Eval(view.GetMyContextFromRoot(root))
    assert contact[1] > 0.1
    assert contact[0] == contact[2] == 0.0


def test_self_contact_equals_collisions_beyond_tips():
    """Links of the Allegro that touch count, two fingertips do not."""
    model = HandModel(load_hand("allegro_right"))
    builder, plant, hand, thing = _plant(model.description)
    view = _view(builder, plant, model.description, hand, thing)
    root = builder.Build().CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, thing, RigidTransform([1.0, 0.0, 0.0]))
    q = np.random.default_rng(0).uniform(model.lower, model.upper, (2000, len(model.lower)))
    beyond, touching = model.collides_beyond_tips(q), model.collides(q)
    tips_alone = touching & ~beyond
    assert min(beyond.sum(), (~touching).sum(), tips_alone.sum()) >= 3
    for row, expected in [*zip(q[:60], beyond[:60], strict=True), *((r, False) for r in q[tips_alone])]:
        for name, angle in zip(model.joint_names, row, strict=True):
            plant.GetJointByName(name, hand).set_angle(context, angle)
        seen = view.GetOutputPort("self_contact").Eval(view.GetMyContextFromRoot(root))
        assert seen.tolist() == [float(expected)]


@pytest.mark.parametrize("modulus", [0.0, 2e5])
def test_touch_is_felt_with_rigid_and_with_soft_fingertips(modulus):
    """A ball 1 mm deep in one fingertip presses on it, by a point or by a surface."""
    text = f"{{plant_config: {{contact_model: hydroelastic_with_fallback}}, fingertip_modulus: {modulus}}}"
    scenario = load_scenario(text=text)
    scenario.object.name = "sphere"
    builder, description = DiagramBuilder(), load_hand(scenario.hand)
    scene = add_scene(builder, scenario, description, np.random.default_rng(0))
    view = _view(builder, scene.plant, description, scene.hand, scene.object_body)
    root = builder.Build().CreateDefaultContext()
    context = scene.plant.GetMyMutableContextFromRoot(root)
    index = description.fingers[1]
    X_WL = scene.plant.GetBodyByName(index.tip_link, scene.hand).EvalPoseInWorld(context)
    # In front of the finger pad; the ball's radius is 30 mm.
    p_WO = X_WL @ (np.array(index.tip_point) + [index.tip_radius + 0.029, 0.0, 0.0])
    scene.plant.SetFloatingBaseBodyPoseInWorldFrame(context, scene.object_body, RigidTransform(p_WO))
    results = scene.plant.get_contact_results_output_port().Eval(context)
    assert (results.num_hydroelastic_contacts() > 0) == (modulus > 0)
    seen = view.GetMyContextFromRoot(root)
    contact = view.GetOutputPort("contact").Eval(seen)
    assert contact[1] > 0.05 and contact[[0, 2, 3]].max() == 0
    assert view.GetOutputPort("self_contact").Eval(seen)[0] == 0
