"""Unusable hand descriptions and models, besides those in test_hand_descriptions.py."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from faults.refusals import Case
from geort_drake.resources import models_dir

LAUGHS = "".join(f'<!ENTITY a{n} "{"".join([f"&a{n - 1};"] * 10) if n else "laugh"}">' for n in range(10))


def facts() -> dict[str, Any]:
    """The right Allegro hand's description."""
    return yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text(encoding="utf-8"))


def sdf() -> str:
    return (models_dir() / "sdf" / "allegro_right.sdf").read_text(encoding="utf-8")


def trained(path: Path) -> tuple:
    return "train", "--hand", path, "--robot_samples", 10, "--output", "out", "--quiet"


def described(text: str | bytes) -> Callable[[Path], tuple]:
    """A description of that text."""

    def make(folder: Path) -> tuple:
        path = folder / "hand.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return trained(path)

    return make


def fields(**changes: object) -> Callable[[Path], tuple]:
    """The Allegro hand's description with other fields."""
    return described(yaml.safe_dump(facts() | changes))


def modelled(text: str, suffix: str = "sdf") -> Callable[[Path], tuple]:
    """The Allegro hand's description with a model of that text."""

    def make(folder: Path) -> tuple:
        (folder / f"hand.{suffix}").write_text(text, encoding="utf-8")
        return fields(model=f"hand.{suffix}")(folder)

    return make


def meshed(vertices: str) -> Callable[[Path], tuple]:
    """The Allegro hand with a mesh of these vertices among its collision shapes."""
    shape = "<collision name='mesh'><geometry><mesh><uri>mesh.obj</uri></mesh></geometry></collision>"

    def make(folder: Path) -> tuple:
        (folder / "mesh.obj").write_text(vertices + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n", encoding="utf-8")
        return modelled(re.sub(r"(<link name=.base_link.>)", rf"\1{shape}", sdf(), count=1))(folder)

    return make


def first_joint(**changes: object) -> Callable[[Path], tuple]:
    fingers = facts()["fingers"]
    fingers[0] |= changes
    return fields(fingers=fingers)


MODEL = "not one readable model|not XML"

_MAKERS: dict[str, tuple[Callable[[Path], tuple], str]] = {
    "a tag that runs code": (described("!!python/object/apply:os.system ['touch harm']"), "is malformed"),
    "a list": (described("- name\n- model\n"), "is malformed"),
    "nothing": (described(""), "is malformed|must be given"),
    "not UTF-8": (described(b"name: \xff\xfe"), "is malformed"),
    "an alias of itself": (described("fingers: &a [*a]"), "is malformed"),
    "fingers that are a number": (fields(fingers=4), "is malformed"),
    "a name that is a list": (fields(name=["a"]), "is malformed"),
    "a tip point that is not finite": (
        first_joint(tip_point=[float("nan"), 0, 0]),
        "tip_point must be three",
    ),
    "a tip radius that is infinite": (first_joint(tip_radius=float("inf")), "tip_radius must be"),
    "a keypoint that is a fraction": (first_joint(human_keypoint=4.5), "is malformed"),
    "a start that is not finite": (fields(default_positions={"joint_0": float("nan")}), "joint_0"),
    "a model that is a folder": (fields(model="."), "is missing"),
    "a model elsewhere": (fields(model="package://geort_drake/../../../../../../etc/passwd"), "passwd"),
    "a model that is a pipe": (fields(model="/dev/stdin"), "is missing|not one readable"),
    "SDF cut off": (modelled(sdf()[: len(sdf()) // 2]), MODEL),
    "SDF without a model": (modelled("<sdf version='1.7'></sdf>"), MODEL),
    "SDF of two models": (
        modelled(
            "<sdf version='1.7'><model name='a'><link name='l'/></model><model name='b'><link name='l'/>"
            "</model></sdf>"
        ),
        MODEL,
    ),
    "SDF that is JSON": (modelled("{}"), MODEL),
    "SDF with entities of entities": (
        modelled(f"<?xml version='1.0'?><!DOCTYPE sdf [{LAUGHS}]><sdf version='1.7'>&a9;</sdf>"),
        MODEL,
    ),
    "SDF that reads another file": (
        modelled(
            "<?xml version='1.0'?><!DOCTYPE sdf [<!ENTITY a SYSTEM 'file:///etc/passwd'>]>"
            "<sdf version='1.7'>&a;</sdf>"
        ),
        MODEL,
    ),
    "URDF without a robot": (modelled("<robot/>", "urdf"), MODEL),
    "URDF of a circle of links": (
        modelled(
            "<robot name='a'><link name='l'/><joint name='j' type='revolute'><parent link='l'/>"
            "<child link='l'/><limit lower='0' upper='1' effort='1' velocity='1'/></joint></robot>",
            "urdf",
        ),
        "readable model|frame or link|joint",
    ),
    "a mass that is not a number": (
        modelled(re.sub(r"<mass>[^<]*", "<mass>nan", sdf(), count=1)),
        "mass of link 'base_link' in hand.sdf must be finite and not negative; given: nan",
    ),
    "a negative mass": (
        modelled(re.sub(r"<mass>[^<]*", "<mass>-1", sdf(), count=1)),
        "mass of link 'base_link' in hand.sdf must be finite and not negative; given: -1",
    ),
    "an inertia that is not a number": (
        modelled(re.sub(r"<ixy>[^<]*", "<ixy>nan", sdf(), count=1)),
        "ixy of link 'base_link' in hand.sdf must be finite; given: nan",
    ),
    "a collision shape of negative size": (
        modelled(re.sub(r"(<collision.*?<size>)[^<]*", r"\1-1 1 1", sdf(), count=1, flags=re.S)),
        "must be finite and not negative; given: -1",
    ),
    "a joint of many turns": (
        modelled(re.sub(r"<lower>[^<]*", "<lower>-1e308", sdf(), count=1)),
        r"joint 'joint_0' needs position limits within ±100 rad; given: \[-1e\+308",
    ),
    "a mesh with a vertex that is not finite": (
        meshed("v 0 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 1\n"),
        "given: v nan 0 0",
    ),
    "a model of no known kind": (modelled("solid", "stl"), MODEL),
}

CASES = [Case("hand", name, make, "HandError", says) for name, (make, says) in _MAKERS.items()]
