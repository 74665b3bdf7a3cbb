"""Scenarios: what to simulate, as data; the schema of `diagrams/*.scenarios.yaml`.

Drake's YAML loader reads the types, so this module must not use postponed annotations.
"""

import dataclasses as dc
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.multibody.parsing import ModelDirective
from pydrake.multibody.plant import MultibodyPlantConfig

from geort_drake.errors import UnknownNameError
from geort_drake.resources import models_dir, object_names
from geort_drake.simulation.person.config import OperatorConfig
from geort_drake.simulation.worn_glove import WornGloveConfig
from geort_drake.systems.corrections import CorrectionConfig
from geort_drake.systems.wrist_to_arm import WristToArmConfig


@dc.dataclass
class ObjectConfig:
    """The object to grasp, and how it varies with the seed."""

    # Stem of a file in models/sdf/objects, or of one in models/sdf/parts that a task needs.
    name: str = "cylinder"
    # Centre of the placement in W, [x, y] in m.
    position: list[float] = dc.field(default_factory=lambda: [0.5, 0.0])
    # Height in W of the support, m.
    support_height: float = 0.1
    # Yaw in W, rad, and factors on the model's mass and friction coefficients.
    yaw: float = 0.0
    mass_factor: float = 1.0
    friction_factor: float = 1.0
    # Largest deviation in x and y, m, and in yaw, rad.
    position_range: float = 0.02
    yaw_range: float = 0.35
    # Mass and friction are multiplied by further factors between 1 - this and 1 + this.
    mass_range: float = 0.2
    friction_range: float = 0.2


@dc.dataclass
class RetargetingConfig:
    """Timing and limits of the retargeter in the diagram."""

    # Time between updates, s.
    period: float = 0.01
    # Limits of the joint targets, rad/s and rad/s².
    max_joint_speed: float = 7.0
    max_joint_acceleration: float = 700.0
    # Cutoff of a low-pass on the joint targets, Hz; 0 for none.
    cutoff: float = 0.0
    # Whether a universal map is adapted to the person in free play before the trial; otherwise the trial
    # begins while it measures them.
    adapts_before: bool = True
    # Duration of a call, s, rounded up to whole steps of the plant. It delays the joint targets, and the
    # retargeter is not called again before they are out.
    latency: float = 0.0


@dc.dataclass
class Scenario:
    """One trial: task, world, person, and the retargeting between person and robot."""

    # Name of the task, a module of geort_drake/simulation/tasks; and values for the task's own settings.
    task: str = "grasp"
    task_settings: dict[str, float] = dc.field(default_factory=dict)
    # Kind of the simulated person, one of the engine's `KINDS`.
    kind: str = "servo"
    # Seed of the object's placement, mass and friction, and of the person's noise.
    random_seed: int = 0
    # Largest duration of the trial, s.
    timeout: float = 25.0
    # Plant settings: SAP, with patches of contact between soft fingertips and the object. The solver is
    # implicit, so a step of 5 ms, half the period of the controllers, is stable under stiff contact. Output
    # ports that are not sampled are computed only when they are read.
    plant_config: MultibodyPlantConfig = dc.field(
        default_factory=lambda: MultibodyPlantConfig(
            time_step=0.005,
            discrete_contact_approximation="sap",
            contact_model="hydroelastic_with_fallback",
            use_sampled_output_ports=False,
        )
    )
    # Arm and surroundings; the arm must be named `arm`.
    directives: list[ModelDirective] = dc.field(default_factory=list)
    # Description of the robot hand: a stem in models/hands, or a path. Its model is added as `hand`.
    hand: str = "allegro_right"
    # Frame to which the hand is welded; the hand's `mount` is relative to it.
    hand_parent: str = "adapter::hand_side"
    # Hydroelastic modulus of the hand's fingertips, Pa, against rigid objects. 1e5 yields like soft rubber,
    # by 2 mm under 1 N at a radius of 12 mm, and friction over the patch keeps an object between two
    # fingertips from turning. 0 selects point contact, which does not. Other values need
    # `plant_config.contact_model: hydroelastic_with_fallback`.
    fingertip_modulus: float = 1e5
    # Whether the arm keeps its initial position. Replays then need no wrist poses.
    fixed_base: bool = False
    # Initial joint positions of the arm by name, rad; and those that differ for a left hand.
    arm_posture: dict[str, float] = dc.field(default_factory=dict)
    left_arm_posture: dict[str, float] = dc.field(default_factory=dict)
    object: ObjectConfig = dc.field(default_factory=ObjectConfig)
    # Number of the simulated person in the population of seed 2000, whom no shipped map has seen in training,
    # see `sample_person`; 0 is the hand of the recording, or an average adult's without a recording.
    person: int = 0
    glove: WornGloveConfig = dc.field(default_factory=WornGloveConfig)
    operator: OperatorConfig = dc.field(default_factory=OperatorConfig)
    retargeting: RetargetingConfig = dc.field(default_factory=RetargetingConfig)
    correction: CorrectionConfig = dc.field(default_factory=CorrectionConfig)
    wrist_to_arm: WristToArmConfig = dc.field(default_factory=WristToArmConfig)
    # Time between frames of the recording for the Rerun viewer, s.
    recording_period: float = 0.02


def object_file(name: str) -> Path:
    """Returns the model file of an object or part; raises UnknownNameError if there is none."""
    for folder in ("objects", "parts"):
        if (path := models_dir() / "sdf" / folder / f"{name}.sdf").is_file():
            return path
    raise UnknownNameError("object", name, object_names())


def parse_scenario(text: str) -> Scenario:
    """Reads the output of `dump_scenario`."""
    return yaml_load_typed(schema=Scenario, data=text, child_name="Resolved", defaults=Scenario())


def scenario_fields(text: str) -> dict:
    """Returns the fields in the output of `dump_scenario` as plain data, without tags such as !Rpy."""
    return yaml.load(text, Loader=_Untagged)["Resolved"]


class _Untagged(yaml.SafeLoader):
    """Reads tagged mappings as mappings."""


_Untagged.add_multi_constructor("!", lambda loader, _, node: loader.construct_mapping(node, deep=True))


def dump_scenario(scenario: Scenario) -> str:
    """Returns the whole scenario as YAML that `load_scenario` reads under the name `Resolved`."""
    return yaml_dump_typed(scenario, child_name="Resolved")
