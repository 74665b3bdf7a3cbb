"""Arm and hand in the meshes of Drake's public models, for who has or may fetch these.

Only what is seen changes; the shapes that collide stay our own.
"""

from pathlib import PurePosixPath

from pydrake.geometry import GeometryInstance, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RevoluteJoint
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError

PACKAGE = "drake_models"
# Of Drake 1.51; both have our links' names and frames, but for the palm's.
PANDA = PurePosixPath("franka_description/urdf/panda_arm.urdf")
HANDS = {
    "allegro_right": PurePosixPath("allegro_hand_description/sdf/allegro_hand_description_right.sdf"),
}
_FIELD = "scenario field recording.public_meshes"
_SAME_PLACE, _SAME_TURN = 1e-3, 5e-3  # m, rad; public files round their poses


def wear_public_meshes(
    plant: MultibodyPlant, scene_graph: SceneGraph, model: ModelInstanceIndex, file: PurePosixPath
) -> None:
    """Draws the links of a model of a finalized plant as a public model of the same robot is drawn.

    The links are those of the same name; the public model's root is the one that carries them. A link
    without public meshes keeps its own shapes.

    Args:
        file: the public model, in the package `drake_models`. A copy of it in ROS_PACKAGE_PATH comes
            first, then what Drake has downloaded or can.

    Raises:
        ScenarioError: the public model cannot be had or read, or it is of another robot: a link has
            another place in it when all joints are at zero.
    """
    builder = DiagramBuilder()
    public, public_scene = AddMultibodyPlantSceneGraph(builder, 0.0)
    try:
        (public_model,) = _parser(public).AddModels(url=f"package://{PACKAGE}/{file}")
    except RuntimeError as error:
        raise ScenarioError(
            f"{_FIELD}: {PACKAGE}/{file} cannot be had: leave the field out, or let "
            f"ROS_PACKAGE_PATH name a folder that holds {PACKAGE}. Drake said: {' '.join(str(error).split())}"
        ) from error
    public.Finalize()
    ours, theirs = _poses_at_zero(plant, model), _poses_at_zero(public, public_model)
    root, public_root = next(iter(ours)), next(iter(theirs))
    shared = [name for name in ours if name in theirs and name not in (root, public_root)]
    if not shared:
        raise ScenarioError(f"{_FIELD}: no link of {file} is one of {list(ours)}")
    # Where the public model's root is on ours.
    X_RP = ours[shared[0]] @ theirs[shared[0]].inverse()
    for name in shared:
        X_off = ours[name].inverse() @ X_RP @ theirs[name]
        turn = X_off.rotation().ToAngleAxis().angle()
        if max(abs(X_off.translation())) > _SAME_PLACE or turn > _SAME_TURN:
            raise ScenarioError(f"{_FIELD}: {file} has link '{name}' elsewhere")
    for name, public_name in [(root, public_root), *zip(shared, shared, strict=True)]:
        X_BP = ours[name].inverse() @ X_RP @ theirs[public_name]
        visuals = _visuals(public, public_scene, public_model, public_name, X_BP)
        _wear(plant, scene_graph, model, name, visuals)


def _parser(plant: MultibodyPlant) -> Parser:
    parser = Parser(plant)
    users = PackageMap.MakeEmpty()
    users.PopulateFromRosPackagePath()
    if users.Contains(PACKAGE):
        parser.package_map().Remove(PACKAGE)
        parser.package_map().Add(PACKAGE, users.GetPath(PACKAGE))
    return parser


def _poses_at_zero(plant: MultibodyPlant, model: ModelInstanceIndex) -> dict[str, RigidTransform]:
    """X_RB of every link of a model in its root R, with its joints at zero; the root comes first."""
    context = plant.CreateDefaultContext()
    for joint in map(plant.get_joint, plant.GetJointIndices(model)):
        if isinstance(joint, RevoluteJoint):
            joint.set_angle(context, 0.0)
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(model)]
    return {
        body.name(): plant.CalcRelativeTransform(context, bodies[0].body_frame(), body.body_frame())
        for body in bodies
    }


def _visuals(
    plant: MultibodyPlant, scene_graph: SceneGraph, model: ModelInstanceIndex, link: str, X_BP: RigidTransform
) -> list[GeometryInstance]:
    """Copies of what is seen of a public link P, placed on our link B."""
    inspector = scene_graph.model_inspector()
    copies = []
    for geometry in plant.GetVisualGeometriesForBody(plant.GetBodyByName(link, model)):
        X_BG = X_BP @ inspector.GetPoseInFrame(geometry)
        copy = GeometryInstance(X_BG, inspector.GetShape(geometry), f"public {inspector.GetName(geometry)}")
        copy.set_illustration_properties(inspector.GetIllustrationProperties(geometry))
        copies.append(copy)
    return copies


def _wear(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    model: ModelInstanceIndex,
    link: str,
    visuals: list[GeometryInstance],
) -> None:
    if not visuals:
        return
    source, body = plant.get_source_id(), plant.GetBodyByName(link, model)
    for geometry in plant.GetVisualGeometriesForBody(body):
        scene_graph.RemoveRole(source, geometry, Role.kIllustration)
    frame = plant.GetBodyFrameIdOrThrow(body.index())
    for visual in visuals:
        scene_graph.RegisterGeometry(source, frame, visual)
