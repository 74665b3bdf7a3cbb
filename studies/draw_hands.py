"""Draws the hands known by name, as their maps follow a person who pinches.

python studies/draw_hands.py docs/images/hands.png

Hands whose models are not on this computer are left out. Drake's VTK engine draws, without a display.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from geort_drake import load_hand, load_retargeter
from geort_drake.console import warn
from geort_drake.errors import HandError
from geort_drake.files import atomic_path
from geort_drake.hands.assembly import add_hand_model
from geort_drake.hands.description import HandDescription, JointCouplings
from geort_drake.hands.geometry import parts_of
from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.synthetic.population import sample_person
from geort_drake.retargeting.store import shipped_maps

UNSEEN = 1000  # seed of a person who is in no training
WIDTH, HEIGHT, FIELD_DEG = 480, 520, 38.0
COLUMNS = 4
LONGEST = 0.12  # m, of a forearm that is drawn
MARGIN = 1.1  # distance of the camera over that from which the hand fills the picture
LIGHTS = [
    LightParameter(type="directional", direction=direction, frame="world", intensity=intensity)
    for direction, intensity in (([-1.0, 0.3, -0.6], 1.1), ([-0.4, -0.8, 0.3], 0.4))
]


def draw(hand: HandDescription, p_HK: np.ndarray) -> np.ndarray:
    """Returns an image (HEIGHT, WIDTH, 3) of a hand that follows the last of p_HK (T, 21, 3), m.

    Raises:
        HandError: the hand's model is missing.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    parameters = RenderEngineVtkParams(default_clear_color=np.ones(3), lights=LIGHTS)
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(parameters))
    instance = add_hand_model(plant, hand)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(hand.base_frame, instance))
    plant.Finalize()
    root = builder.Build().CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    couplings = JointCouplings(hand)

    def pose(q: np.ndarray) -> np.ndarray:
        """Sets the joint angles q (n,), rad; returns the fingertips (F, 3) in B, m."""
        angles = couplings.with_followers(q[None])[0]
        for name, angle in zip([*hand.joint_names, *couplings.names], angles, strict=True):
            plant.GetJointByName(name, instance).set_angle(context, angle)
        frames = [plant.GetFrameByName(finger.tip_link, instance) for finger in hand.fingers]
        return np.array([
            frame.CalcPoseInWorld(context) @ finger.tip_point
            for frame, finger in zip(frames, hand.fingers, strict=True)
        ])  # fmt: skip

    retarget = load_retargeter(hand.name).for_person(p_HK)
    low, high = retarget.lower, retarget.upper
    tips = np.stack([pose(q) for q in np.random.default_rng(0).uniform(low, high, (200, len(low)))])
    top, bottom = tips[..., 2].max(), hand_bottom(plant, scene_graph, instance)
    pose(retarget(p_HK[-1]))
    side = 1.0 if hand.side == "right" else -1.0
    target = np.array([0.02, 0.0, 0.5 * (top + bottom)])
    distance = MARGIN * 0.5 * (top - bottom) / np.tan(np.deg2rad(0.5 * FIELD_DEG))
    z = -np.array([0.8, -0.5 * side, 0.3]) / np.linalg.norm([0.8, 0.5, 0.3])
    x = np.cross(z, [0.0, 0.0, 1.0]) / np.linalg.norm(z[:2])
    X_WC = RigidTransform(RotationMatrix(np.column_stack([x, np.cross(z, x), z])), target - distance * z)
    info = CameraInfo(WIDTH, HEIGHT, np.deg2rad(FIELD_DEG))
    core = RenderCameraCore("vtk", info, ClippingRange(0.01, 5.0), RigidTransform())
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(root))
    image = query.RenderColorImage(ColorRenderCamera(core, False), scene_graph.world_frame_id(), X_WC)
    return image.data[..., :3].copy()


def hand_bottom(plant: MultibodyPlant, scene_graph: SceneGraph, hand: ModelInstanceIndex) -> float:
    """Returns the lowest z of the hand's collision geometry, m, but no less than −LONGEST."""
    links = map(plant.get_body, plant.GetBodyIndices(hand))
    parts = parts_of(plant, scene_graph, links, Role.kProximity, plant.world_frame())
    return max(min(part.points[:, 2].min() for part in parts), -LONGEST)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("output", type=Path)
    arguments = parser.parse_args(argv)
    p_HK = sample_person(UNSEEN, 1).record(40.0, 30.0).p_HK
    tips = p_HK[:, TIP_KEYPOINT["thumb"]] - p_HK[:, TIP_KEYPOINT["index"]]
    pinch = int(np.linalg.norm(tips, axis=-1).argmin())
    p_HK = np.concatenate([p_HK[:60], p_HK[pinch : pinch + 1]])
    images = {}
    for name in shipped_maps():
        try:
            images[name] = draw(load_hand(name), p_HK)
        except HandError as error:
            warn(str(error))
    rows = -(-len(images) // COLUMNS)
    figure, axes = plt.subplots(rows, COLUMNS, figsize=(2.4 * COLUMNS, 2.8 * rows), squeeze=False)
    for ax in axes.flat:
        ax.axis("off")
    for ax, (name, image) in zip(axes.flat, images.items(), strict=False):
        ax.imshow(image)
        ax.set_title(name, fontsize=9)
    figure.tight_layout(pad=0.3)
    with atomic_path(arguments.output) as draft:
        figure.savefig(draft, format="png", dpi=110)


if __name__ == "__main__":
    main()
