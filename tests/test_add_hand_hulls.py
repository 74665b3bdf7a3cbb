"""Links without collision geometry collide with their visual geometry, in every format."""

import numpy as np
import pytest
from hand_family import HandSpec, write_hand
from pydrake.geometry import Role

from geort_drake import HandModel, load_hand
from geort_drake.cli import run_command
from geort_drake.hands.importers.checks import examine
from geort_drake.hands.importers.conversion import add_collisions
from geort_drake.hands.importers.fingertips import surface_points
from geort_drake.hands.importers.proposal import propose

# A rigid part that hangs on the index finger's last link, off its axes, and how far it reaches along them.
PARTS = {
    "urdf": '<link name="nail"><visual><origin xyz="0.001 0.002 0.003"/><geometry>'
    '<box size="0.01 0.02 0.03"/></geometry></visual></link><joint name="glue" type="fixed">'
    '<parent link="index_l3"/><child link="nail"/><origin xyz="0 0 0.02"/></joint></robot>',
    "sdf": '<link name="nail"><pose relative_to="index_l3">0 0 0.02 0 0 0</pose><visual name="v">'
    "<pose>0.001 0.002 0.003 0 0 0</pose><geometry><box><size>0.01 0.02 0.03</size></box></geometry></visual>"
    '</link><joint name="glue" type="fixed"><parent>index_l3</parent><child>nail</child></joint></model>',
}
ENDS = {"urdf": "</robot>", "sdf": "</model>"}


def drawn_alone(folder, kind: str):
    """A hand of the family with visual geometry alone, and a part welded to one link."""
    changes = {"<geom ": '<geom contype="0" conaffinity="0" '}
    if kind != "xml":
        changes = {r"(</?)collision": r"\1visual", ENDS[kind]: PARTS[kind]}
    return write_hand(folder, HandSpec(3, kind, mimic=False), changes=changes)


def reach(hand: HandModel, link: str, role: Role) -> np.ndarray:
    """(2, 3) bounds, along a link's axes, of its geometry and that of links welded to it, m."""
    inspector, points = hand.scene_graph.model_inspector(), []
    owner = hand.plant.GetBodyByName(link)
    context = hand.plant.CreateDefaultContext()
    for body in hand.plant.GetBodiesWeldedTo(owner):
        X_LB = body.body_frame().CalcPose(context, owner.body_frame())
        for id in inspector.GetGeometries(hand.plant.GetBodyFrameIdOrThrow(body.index()), role):
            points.append((X_LB @ inspector.GetPoseInFrame(id) @ surface_points(inspector, id).T).T)
    return np.array([np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)])


@pytest.mark.parametrize("kind", ["urdf", "sdf", "xml"])
def test_bare_links_collide_with_what_is_drawn(kind, tmp_path):
    """Collision geometry is as large as the visual geometry; the checks then find no fault."""
    model = drawn_alone(tmp_path, kind)
    before = HandModel(propose(model).description)
    assert "--hulls" in examine(before)[0]
    given = add_collisions(model)
    drawn = ["palm", *(f"{f}_l{n}" for f in ("thumb", "index", "middle") for n in range(4))]
    bare = {"thumb_l0", "thumb_l3", "index_l0", "middle_l0"}
    assert set(given) == set(drawn) - bare | ({"nail"} if kind in PARTS else set())
    hand = HandModel(propose(model).description)
    for link in given:
        found, wanted = (reach(hand, link, role) for role in (Role.kProximity, Role.kIllustration))
        np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert not any("without collision" in text or "no collision" in text for text in examine(hand))
    assert add_collisions(model) == []


def test_the_command_describes_a_copy(tmp_path):
    """With --hulls; the model itself does not change."""
    model = drawn_alone(tmp_path, "urdf")
    before = model.read_bytes()
    output = tmp_path / "described" / "hand.yaml"
    output.parent.mkdir()
    run_command("add-hand", [str(model), "--hulls", "--output", str(output), "--quiet"])
    assert model.read_bytes() == before
    hand = HandModel(load_hand(output))
    assert hand.scene_graph.model_inspector().NumGeometriesWithRole(Role.kProximity) == 13
