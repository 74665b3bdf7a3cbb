"""Checks a hand description and its model for faults."""

import itertools
from collections import Counter
from collections.abc import Iterator

import numpy as np
from pydrake.geometry import Role
from pydrake.multibody.tree import Joint
from scipy.optimize import least_squares

from geort_drake.errors import listed
from geort_drake.hands.geometry import parts_of
from geort_drake.hands.hand import Hand
from geort_drake.hands.importers.fingers import CLOSING_FRACTION, finger_shapes, unit
from geort_drake.hands.kinematics import FingerChain

# Joint ranges outside of these are probably mistakes, rad.
_NARROW_RANGE, _WIDE_RANGE = np.deg2rad(5.0), 2.0 * np.pi
_FINGER_LENGTHS = (0.01, 0.45)  # from the first joint to the tip, m
# The fraction of its range that a joint should keep within the limits of its followers.
_FREE_FRACTION = 0.75
# Links that touch in a larger fraction of random postures hinder the hand.
FREQUENT_FRACTION = 0.4
_POSTURES = 100
_PINCH_SAMPLES, _PINCH_STARTS = 2000, 4
_MEETING = 1e-4  # m; tips that come so near to each other need no better start
# Fingers must be misplaced by more than this for a finding, m.
_ORDER_MARGIN = 0.005
# A stretched finger may lean by this angle from +z, or bend by it from +x, degrees.
_LEANING = 50.0
# A tip may be this far outside of its link's geometry, in addition to its radius, m.
_TIP_MARGIN = 0.015
# Shorter links need no collision geometry, m.
_SHORT_LINK = 0.012


def examine(hand: Hand) -> list[str]:
    """Returns sentences that name the hand's faults, most important first."""
    checks = (_lengths, _orientation, _tips, _limits, _pinches, _collisions, _masses)
    return [text for check in checks for text in check(hand)]


def contact_fractions(hand: Hand) -> dict[tuple[str, str], float]:
    """Maps pairs of links, except fingertips, to the fraction of random postures in which they touch."""
    counts: Counter[tuple[str, str]] = Counter()
    for q in hand.sample(_POSTURES):
        counts.update({(a, b) for _, a, b, tips in hand.penetrations(q) if not tips})
    return {pair: count / _POSTURES for pair, count in counts.items()}


def _lengths(hand: Hand) -> Iterator[str]:
    low, high = _FINGER_LENGTHS
    for chain in hand.kinematics().fingers:
        length = _link_lengths(chain).sum()
        if not low <= length <= high:
            yield (
                f"{chain.name} is {length:.3g} m long: is it a finger, and are model and meshes in metres?"
            )


def _limits(hand: Hand) -> Iterator[str]:
    for name, low, high in zip(hand.joint_names, hand.lower, hand.upper, strict=True):
        degrees = f"from {np.rad2deg(low):.0f} to {np.rad2deg(high):.0f} degrees"
        if high - low < _NARROW_RANGE:
            yield f"joint '{name}' moves only {degrees}: are its limits in radians?"
        elif high - low > _WIDE_RANGE:
            yield f"joint '{name}' moves {degrees}, more than a full turn: give it narrower limits"
        joint = hand.plant.GetJointByName(name)
        if high - low < _FREE_FRACTION * (joint.position_upper_limit() - joint.position_lower_limit()):
            yield f"joint '{name}' moves only {degrees}, because of its followers' limits"


def _pinches(hand: Hand) -> Iterator[str]:
    if "thumb" not in hand.finger_names:
        yield "no finger is called thumb, so the hand cannot pinch"
        return
    thumb = hand.description.fingers[0]
    for number, finger in enumerate(hand.description.fingers[1:], start=1):
        distance = 1e3 * nearest_pinch(hand, number)
        touch = 1e3 * (thumb.tip_radius + finger.tip_radius)
        if distance > touch:
            yield (
                f"the tips of thumb and {finger.name} touch at {touch:.0f} mm, but come no nearer than "
                f"{distance:.0f} mm: the pinch is out of reach, or tip_point, tip_radius, base or limits are "
                "wrong"
            )


def nearest_pinch(hand: Hand, number: int) -> float:
    """Finds the smallest distance, m, between the tips of finger 0 and `number`; ignores collisions."""

    def offset(q: np.ndarray) -> np.ndarray:
        p_BF = hand.fingertips(q)
        return p_BF[..., 0, :] - p_BF[..., number, :]

    q = hand.sample(_PINCH_SAMPLES)
    starts = q[np.argsort(np.linalg.norm(offset(q), axis=1))[:_PINCH_STARTS]]
    of_both = {*hand.description.fingers[0].joints, *hand.description.fingers[number].joints}
    columns = [column for column, name in enumerate(hand.joint_names) if name in of_both]
    limits, nearest = (hand.lower[columns], hand.upper[columns]), np.inf
    for start in starts:

        def offset_of_both(q_both: np.ndarray, start: np.ndarray = start) -> np.ndarray:
            posture = start.copy()
            posture[columns] = q_both
            return offset(posture)

        solution = least_squares(offset_of_both, start[columns], bounds=limits, xtol=1e-5)
        nearest = min(nearest, float(np.linalg.norm(solution.fun)))
        if nearest < _MEETING:
            break
    return nearest


def _orientation(hand: Hand) -> Iterator[str]:
    """Finds fingers that lie, point or bend against the axes of the hand base."""
    sign = 1.0 if hand.description.side == "right" else -1.0
    names, shapes = hand.finger_names, finger_shapes(hand, np.clip(0.0, hand.lower, hand.upper))
    fingers = [number for number, name in enumerate(names) if name != "thumb"]
    for number in fingers:
        joints = ", ".join(f"'{joint}'" for joint in hand.description.fingers[number].joints)
        shape = shapes[number]
        angle = _angle(shape.direction, 2)
        if angle > _LEANING:
            yield (
                f"{names[number]} (joints {joints}) points {angle:.0f} degrees away from +z of the hand base "
                "when it is stretched: base_pose or base_frame is wrong, or the joints' limits are"
            )
        bends = np.linalg.norm(shape.bending) > CLOSING_FRACTION
        angle = _angle(shape.bending, 0)
        if bends and angle > _LEANING:
            yield (
                f"{names[number]} (joints {joints}) bends {angle:.0f} degrees away from +x of the hand base: "
                "base_pose, base_frame or side is wrong, or the joints' limits are"
            )
    knuckles = sign * np.array([shape.p_knuckle[1] for shape in shapes])
    if "thumb" in names and fingers:
        thumb = names.index("thumb")
        y = sign * 0.5 * np.array([shape.p_base[1] + shape.p_middle[1] for shape in shapes])
        if y[thumb] < y[fingers].min() - _ORDER_MARGIN:
            yield (
                f"the thumb lies on the little finger's side of a {hand.description.side} hand: side or "
                "base_pose is wrong, or the fingers' names are"
            )
    order = [knuckles[number] for number in fingers]
    if any(second > first + _ORDER_MARGIN for first, second in itertools.pairwise(order)):
        yield f"the fingers {', '.join(names[f] for f in fingers)} do not lie in this order"


def _angle(v: np.ndarray, axis: int) -> float:
    """Returns the angle between v (3,) and an axis of its frame, degrees."""
    return float(np.rad2deg(np.arccos(np.clip(unit(v)[axis], -1.0, 1.0))))


def _tips(hand: Hand) -> Iterator[str]:
    """Finds fingertips far from their fingers."""
    plant, chains = hand.plant, hand.kinematics().fingers
    median = float(np.median([_link_lengths(chain).sum() for chain in chains]))
    for finger, chain in zip(hand.description.fingers, chains, strict=True):
        joint, last = chain.all_joint_names[-1], _link_lengths(chain)[-1]
        if last > median:
            yield (
                f"the tip of {finger.name} lies {1e3 * last:.0f} mm from its last joint '{joint}', farther "
                f"than fingers are long ({1e3 * median:.0f} mm): correct tip_link, tip_point or the model's "
                "geometry"
            )
        frame = plant.GetBodyByName(finger.tip_link, hand.instance).body_frame()
        links = plant.GetBodiesWeldedTo(frame.body())
        for role, kind in ((Role.kProximity, "collision"), (Role.kIllustration, "visual")):
            points = [part.points for part in parts_of(plant, hand.scene_graph, links, role, frame)]
            if not points:
                continue
            corners = np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)
            beside = finger.tip_point - np.clip(finger.tip_point, *corners)
            distance = float(np.linalg.norm(beside))
            if distance > finger.tip_radius + _TIP_MARGIN:
                yield (
                    f"the tip of {finger.name} lies {1e3 * distance:.0f} mm beside the {kind} geometry of "
                    f"'{finger.tip_link}', which joint '{joint}' moves: correct tip_point or the geometry"
                )


def _collisions(hand: Hand) -> Iterator[str]:
    plant, inspector = hand.plant, hand.scene_graph.model_inspector()
    if inspector.NumGeometriesWithRole(Role.kProximity) == 0:
        yield (
            "the model has no collision geometry: it can neither avoid self-collision nor grasp; "
            "`geort-drake hand add --hulls` makes some from the visual geometry"
        )
        return

    def geometries(link: str) -> list:
        bodies = plant.GetBodiesWeldedTo(plant.GetBodyByName(link))
        frames = [plant.GetBodyFrameIdOrThrow(body.index()) for body in bodies]
        return [id for frame in frames for id in inspector.GetGeometries(frame, Role.kProximity)]

    tips_without_geometry = [
        finger.tip_link for finger in hand.description.fingers if not geometries(finger.tip_link)
    ]
    if tips_without_geometry:
        yield f"fingertips without collision geometry touch nothing: {', '.join(tips_without_geometry)}"
    long = [joint.child_body().name() for joint, length in _links(hand) if length > _SHORT_LINK]
    if without := [link for link in long if link not in tips_without_geometry and not geometries(link)]:
        yield f"links of fingers without collision geometry: {listed(without)}"
    shares = sorted(contact_fractions(hand).items(), key=lambda item: (-item[1], item[0]))
    if often := [f"'{a}' and '{b}' in {share:.0%}" for (a, b), share in shares if share >= FREQUENT_FRACTION]:
        yield (
            f"links touch in many postures, {listed(often)}: correct their shapes, or list the pairs in "
            "ignored_collisions"
        )
    # Parts that only touch, without depth, are no fault.
    if pairs := {f"'{a}' and '{b}'" for _, a, b, _ in hand.penetrations(hand.default_position)}:
        yield f"the hand starts in self-collision: {listed(sorted(pairs))}; see default_positions"


def _masses(hand: Hand) -> Iterator[str]:
    plant, light = hand.plant, []
    for joint, _ in _links(hand):
        bodies = map(plant.get_body, plant.GetBodiesKinematicallyAffectedBy([joint.index()]))
        if not sum(body.default_mass() for body in bodies) > 0:
            light.append(joint.child_body().name())
    if light:
        yield f"links without mass cannot be simulated: {listed(light)}"
    if loose := [plant.get_body(index).name() for index in plant.GetFloatingBaseBodies()]:
        yield f"these parts fall freely, as nothing connects them to the palm: {listed(loose)}"


def _links(hand: Hand) -> list[tuple[Joint, float]]:
    """Returns the fingers' joints and the lengths of their links, m: from a joint to the next or the tip."""
    return [
        (hand.plant.GetJointByName(name), length)
        for chain in hand.kinematics().fingers
        for name, length in zip(chain.all_joint_names, _link_lengths(chain).tolist(), strict=True)
    ]


def _link_lengths(chain: FingerChain) -> np.ndarray:
    """Returns the distances (n,) from each of a finger's n joints to the next or the tip, m."""
    return np.linalg.norm([*chain.X_PJ[1:, :3, 3], chain.p_tip], axis=1)
