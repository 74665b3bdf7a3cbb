"""What is wrong with a hand description and its model, in plain words."""

import itertools

import numpy as np
from pydrake.geometry import Convex, Mesh, Role
from scipy.optimize import minimize

from geort_drake.hands.importers.resting import contact_shares
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

# Ranges of joints outside of these are mistakes more often than not, rad.
_NARROW, _WIDE = np.deg2rad(5.0), 2.0 * np.pi
# A joint should be left this part of its range by the limits of what follows it.
_LEFT = 0.75
# Links that touch in this part of random postures leave the hand little to do.
_OFTEN = 0.4
_SAMPLES, _STARTS = 2000, 4
# Fingers lie on the wrong side of each other if they do so by this much, m.
_ASIDE = 0.005
# Shorter links are joints' bodies, which need no collision geometry, m.
_LONG = 0.012


def examine(hand: HandModel) -> list[str]:
    """Sentences on what to correct, most important first; none for a hand without fault."""
    return [*_limits(hand), *_pinches(hand), *_orientation(hand), *_collisions(hand), *_masses(hand)]


def _limits(hand: HandModel) -> list[str]:
    said = []
    for name, low, high in zip(hand.joint_names, hand.lower, hand.upper, strict=True):
        degrees = f"from {np.rad2deg(low):.0f} to {np.rad2deg(high):.0f} degrees"
        if high - low < _NARROW:
            said.append(f"joint '{name}' moves only {degrees}: are its limits in radians?")
        elif high - low > _WIDE:
            said.append(f"joint '{name}' moves {degrees}, more than a turn: give it narrower limits")
        joint = hand.plant.GetJointByName(name)
        if high - low < _LEFT * (joint.position_upper_limit() - joint.position_lower_limit()):
            said.append(f"joint '{name}' moves only {degrees}, because what follows it has limits, too")
    return said


def _pinches(hand: HandModel) -> list[str]:
    if "thumb" not in hand.finger_names:
        return ["there is no finger called thumb, so nothing pinches"]
    kinematics = NumpyKinematics.of(hand.kinematics())
    thumb = hand.description.fingers[0]
    said = []
    for number, finger in enumerate(hand.description.fingers[1:], start=1):
        reach = 1e3 * nearest_pinch(kinematics, number)
        touch = 1e3 * (thumb.tip_radius + finger.tip_radius)
        if reach > touch:
            said.append(
                f"thumb and {finger.name} tips come no nearer than {reach:.0f} mm, and touch at {touch:.0f}: "
                "their pinch is out of reach, or tip_point, tip_radius, base or limits are wrong"
            )
    return said


def nearest_pinch(kinematics: NumpyKinematics, number: int, seed: int = 0) -> float:
    """How near the first finger's tip can come to that of finger `number`, m; self-collision aside."""
    q = np.random.default_rng(seed).uniform(
        kinematics.lower, kinematics.upper, (_SAMPLES, len(kinematics.joint_names))
    )
    p_BF = kinematics.fingertips(q)
    starts = q[np.argsort(np.linalg.norm(p_BF[:, 0] - p_BF[:, number], axis=1))[:_STARTS]]

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        p_BF, J = kinematics.fingertips_and_jacobians(x[None])
        v = p_BF[0, 0] - p_BF[0, number]
        return 1e4 * v @ v, 2e4 * v @ (J[0, 0] - J[0, number])

    bounds = list(zip(kinematics.lower, kinematics.upper, strict=True))
    found = [minimize(cost, start, jac=True, bounds=bounds, method="L-BFGS-B").fun for start in starts]
    return float(np.sqrt(min(found) / 1e4))


def _orientation(hand: HandModel) -> list[str]:
    """Whether the fingers lie and close as the hand base's axes promise."""
    said = []
    rng = np.random.default_rng(0)
    p_BF = hand.fingertips(rng.uniform(hand.lower, hand.upper, (_SAMPLES // 4, len(hand.joint_names))))
    sign = 1.0 if hand.description.side == "right" else -1.0
    names = hand.finger_names
    fingers = [number for number, name in enumerate(names) if name != "thumb"]
    if "thumb" in names and fingers:
        thumb = names.index("thumb")
        y = sign * p_BF[..., 1].mean(axis=0)
        if y[thumb] < y[fingers].min() - _ASIDE:
            said.append(
                f"the thumb lies on the little finger's side of a {hand.description.side} hand: side or "
                "base_pose is wrong, or the fingers' names are"
            )
    knuckles = [sign * chain.X_PJ[0, 1, 3] for chain in hand.kinematics().fingers]
    order = [knuckles[number] for number in fingers]
    if any(second > first + _ASIDE for first, second in itertools.pairwise(order)):
        said.append(f"the fingers {', '.join(names[f] for f in fingers)} do not lie in this order")
    return said


def _collisions(hand: HandModel) -> list[str]:
    plant, inspector = hand.plant, hand.scene_graph.model_inspector()
    if inspector.NumGeometriesWithRole(Role.kProximity) == 0:
        return [
            "the model has no collision geometry: self-collision is not avoided and nothing can be grasped; "
            "add_hand.py --hulls makes some of what is drawn"
        ]
    said = []

    def shapes(link: str) -> list:
        bodies = plant.GetBodiesWeldedTo(plant.GetBodyByName(link))
        frames = [plant.GetBodyFrameIdOrThrow(body.index()) for body in bodies]
        found = [id for frame in frames for id in inspector.GetGeometries(frame, Role.kProximity)]
        return [inspector.GetShape(geometry) for geometry in found]

    bare = [finger.tip_link for finger in hand.description.fingers if not shapes(finger.tip_link)]
    if bare:
        said.append(f"fingertips without collision geometry touch nothing: {', '.join(bare)}")
    without = [
        link for link, length in _links(hand) if length > _LONG and link not in bare and not shapes(link)
    ]
    if without:
        said.append(f"links of fingers without collision geometry: {', '.join(without)}")
    meshes = [id for id in inspector.GetAllGeometryIds(Role.kProximity) if _is_mesh(inspector.GetShape(id))]
    if meshes:
        said.append(
            f"{len(meshes)} collision shapes are meshes: their hulls count, in training boxes as large; "
            "boxes, spheres, cylinders and capsules are exact and faster"
        )
    for (a, b), share in sorted(contact_shares(hand).items(), key=lambda item: -item[1]):
        if share >= _OFTEN:
            said.append(
                f"'{a}' and '{b}' touch in {share:.0%} of postures: correct their shapes, or put the pair "
                "under ignored_collisions"
            )
    if hand.collides(hand.default_position):
        pairs = {f"'{a}' and '{b}'" for _, a, b, _ in hand.penetrations(hand.default_position)}
        said.append(f"the hand starts in self-collision: {', '.join(sorted(pairs))}; see default_positions")
    return said


def _masses(hand: HandModel) -> list[str]:
    light = [link for link, _ in _links(hand) if not hand.plant.GetBodyByName(link).default_mass() > 0]
    return [f"links without mass cannot be simulated: {', '.join(light)}"] if light else []


def _links(hand: HandModel) -> list[tuple[str, float]]:
    """The links that joints of fingers move, and how far from each joint the next one or the tip is, m."""
    links = []
    for chain in hand.kinematics().fingers:
        lengths = np.linalg.norm([*chain.X_PJ[1:, :3, 3], chain.p_tip], axis=1)
        for name, length in zip(chain.all_joint_names, lengths, strict=True):
            links.append((hand.plant.GetJointByName(name).child_body().name(), float(length)))
    return links


def _is_mesh(shape: object) -> bool:
    return isinstance(shape, Mesh | Convex)
