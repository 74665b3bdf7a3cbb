"""Rewrites MJCF so that Drake 1.51 reads the same model as MuJoCo."""

import copy
import xml.etree.ElementTree as ET
from collections.abc import Mapping

_POSE = ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler")  # of a body


def rewrite_for_drake(tree: ET.Element) -> None:
    """Rewrites a model, without includes, in place.

    Default classes become complete: Drake inherits an element's settings only if the inner class has such an
    element itself. Otherwise joints, geoms and actuators lose their axes, limits, sizes and gains. Servos,
    frames and bodies with several joints become what Drake reads. What is fixed beside the hand, such as a
    floor or a table, is left out.
    """
    _merge_defaults(tree)
    for outer in tree.iter("default"):  # outer classes come first
        for inner in outer.findall("default"):
            _inherit(inner, outer)
    _rewrite_servos(tree)
    for inertial in tree.iter("inertial"):
        if not inertial.get("mass", "1").strip("0. "):  # of a fixed body; Drake 1.51 would fail
            inertial.attrib = {"pos": "0 0 0", "mass": "1e-9", "diaginertia": "1e-15 1e-15 1e-15"}
    for number, frame in enumerate(tree.findall("worldbody//frame")):  # Drake 1.51 ignores them
        frame.tag = "body"
        frame.set("name", frame.get("name") or f"frame_{number}")
    if tree.find("worldbody//joint") is not None:
        _remove_surroundings(tree)
    _separate_joints(tree)


def _merge_defaults(tree: ET.Element) -> None:
    """Merges the top-level default classes, of which Drake 1.51 regards the last alone."""
    defaults = tree.findall("default")
    for default in defaults[1:]:
        tree.remove(default)
        for settings in default:
            own = defaults[0].find(settings.tag)
            if settings.tag == "default" or own is None:
                defaults[0].append(settings)
            else:
                own.attrib |= settings.attrib


def _remove_surroundings(tree: ET.Element) -> None:
    """Removes geoms and bodies beside the hand that cannot move, and what refers to these bodies."""
    gone: set[str] = set()
    for world in tree.iter("worldbody"):
        for part in [*world.findall("geom"), *world.findall("body")]:
            if not {inner.tag for inner in part.iter()} & {"joint", "freejoint"}:
                world.remove(part)
                gone |= {body.get("name", "") for body in part.iter("body")}
    for section in (*tree.findall("contact"), *tree.findall("equality")):
        for entry in list(section):
            if gone & {entry.get("body1"), entry.get("body2")}:
                section.remove(entry)


def _separate_joints(tree: ET.Element) -> None:
    """Gives each joint a body of its own.

    Drake 1.51 puts all joints of a body but the last one at the origin of the body's parent.
    """
    parents = {child: parent for parent in tree.iter() for child in parent}
    for body in [body for body in tree.iter("body") if len(body.findall("joint")) > 1]:
        parent, name = parents[body], body.get("name", "body")
        place = list(parent).index(body)
        parent.remove(body)
        pose = {key: body.attrib.pop(key) for key in _POSE if key in body.attrib}
        if parent.get("name") and body.get("name"):  # MuJoCo ignores contacts of neighbouring bodies
            contact = ET.SubElement(tree, "contact")
            ET.SubElement(contact, "exclude", body1=parent.get("name", ""), body2=name)
        for number, joint in enumerate(body.findall("joint")[:-1]):
            body.remove(joint)
            outer = ET.Element("body", {**body.attrib, **pose, "name": f"{name}_{number}"})
            outer.append(joint)
            parent.insert(place, outer)
            parent, place, pose = outer, 1, {}
        parent.append(body)


def _inherit(inner: ET.Element, outer: ET.Element) -> None:
    """Adds to a default class the settings that it lacks of the class around it."""
    for settings in outer:
        own = inner.find(settings.tag)
        if settings.tag != "default" and own is None:
            inner.append(copy.deepcopy(settings))
        elif settings.tag != "default" and own is not None:
            own.attrib = {**settings.attrib, **own.attrib}


def _rewrite_servos(tree: ET.Element) -> None:
    """Turns general actuators that are position servos into `position`, and removes ranges of their inputs.

    Drake 1.51 ignores `general`, and takes the range of a servo's input, rad, for its largest torque.
    """
    classes = {default.get("class", "main"): default for default in tree.iter("default")}
    for servo in (*tree.iterfind("actuator/general"), *tree.iterfind("actuator/position")):
        inherited = classes.get(servo.get("class", "main"), tree).find(servo.tag)
        given = {**({} if inherited is None else inherited.attrib), **servo.attrib}
        kp = given.get("kp", "1")
        if servo.tag == "general":
            kp = _servo_gain(given)
            if not kp:
                continue
        servo.tag = "position"
        kept = ("name", "class", "joint", "tendon", "gear", "forcerange", "forcelimited")
        servo.attrib = {name: given[name] for name in kept if name in given}
        servo.attrib |= {"kp": kp, "ctrllimited": "false"}


def _servo_gain(general: Mapping[str, str]) -> str:
    """Returns the gain of a general actuator with force gain · (input − position); "" for any other."""
    gain, bias = (general.get(name, "").split() for name in ("gainprm", "biasprm"))
    try:
        is_servo = general.get("biastype") == "affine" and float(bias[1]) == -float(gain[0])
    except (ValueError, IndexError):
        return ""
    return gain[0] if is_servo else ""
