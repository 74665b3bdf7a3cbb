"""Scenarios: what to simulate, as data; the schema of `diagrams/*.scenarios.yaml`, and its reader.

Drake's YAML loader reads the types, so this module must not use postponed annotations.
"""

import dataclasses as dc
import math
import os
from operator import attrgetter
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.multibody.parsing import ModelDirective
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError, UnknownNameError
from geort_drake.resources import diagrams_dir, models_dir
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.intention import IntentionConfig
from geort_drake.simulation.tasks.grasp.monitor import GraspMonitorConfig
from geort_drake.simulation.worn_glove import WornGloveConfig
from geort_drake.systems.action_correction import CorrectionConfig
from geort_drake.systems.update_timing import check_timing
from geort_drake.systems.wrist_to_arm import WristToArmConfig

# Rule → numeric fields.
_RULES = (
    (
        "positive and finite",
        lambda value: 0 < value < math.inf,
        (
            "timeout",
            "plant_config.time_step",
            "retargeting.period",
            "retargeting.max_joint_speed",
            "retargeting.max_joint_acceleration",
            "recording.period",
            "hand_stiffness_factor",
            "object.mass_factor",
            "object.friction_factor",
        ),
    ),
    ("finite", math.isfinite, ("object.support_height", "object.yaw")),
    (
        "finite and not negative",
        lambda value: 0 <= value < math.inf,
        ("object.position_range", "object.yaw_range", "fingertip_modulus"),
    ),
    ("in [0, 1)", lambda value: 0 <= value < 1, ("object.mass_range", "object.friction_range")),
    ("0 or more", lambda value: value >= 0, ("random_seed", "person")),
)
_MIN_TIME_STEP = 1e-5  # s; with a shorter step, a trial would take hours
# These must be multiples of the plant's time step.
_PERIODS = tuple(
    f"{part}.period" for part in ("retargeting", "wrist_to_arm", "operator", "monitor", "recording")
)


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
    # Duration of a call, s, rounded up to whole steps of the plant. It delays the joint targets, and the
    # retargeter is not called again before they are out.
    latency: float = 0.0


@dc.dataclass
class RecordingConfig:
    """Recordings for the Rerun viewer."""

    # Time between recorded frames, s.
    period: float = 0.02
    # Without effect; kept so that earlier scenarios load.
    public_meshes: bool = False


@dc.dataclass
class Scenario:
    """One trial: the task, the world, the person, and the chain between them."""

    # What the person does, a folder in geort_drake/simulation/tasks; and numbers of its own settings.
    task: str = "grasp"
    task_settings: dict[str, float] = dc.field(default_factory=dict)
    # Kind of the simulated person; the task lists those that it has.
    kind: str = "servo"
    # Seed of the object's placement, mass and friction, and of the person's noise.
    random_seed: int = 0
    # Largest duration of the trial, s.
    timeout: float = 25.0
    # Plant settings: SAP with point contact. Output ports that are not sampled are computed only when they
    # are read.
    plant_config: MultibodyPlantConfig = dc.field(
        default_factory=lambda: MultibodyPlantConfig(
            time_step=0.002,
            discrete_contact_approximation="sap",
            contact_model="point",
            use_sampled_output_ports=False,
        )
    )
    # Arm and surroundings; the arm must be named `arm`.
    directives: list[ModelDirective] = dc.field(default_factory=list)
    # Description of the robot hand: a stem in models/hands, or a path. Its model is added as `hand`, unless
    # the directives add it.
    hand: str = "allegro_right"
    # Frame that carries the hand; the hand's `mount` is relative to it.
    hand_parent: str = "adapter::hand_side"
    # Factor on the proportional gains of the hand's controllers; damping ratios stay.
    hand_stiffness_factor: float = 1.0
    # Hydroelastic modulus of the hand's fingertips, Pa, on rigid objects; soft rubber has about 1e5. 0: point
    # contact. Other values need `plant_config.contact_model: hydroelastic_with_fallback`.
    fingertip_modulus: float = 0.0
    # Whether the arm stays where it starts. Replays then need no wrist poses.
    fixed_base: bool = False
    # Joint positions of the arm at the start, by name, rad; and those that differ for a left hand.
    arm_posture: dict[str, float] = dc.field(default_factory=dict)
    left_arm_posture: dict[str, float] = dc.field(default_factory=dict)
    object: ObjectConfig = dc.field(default_factory=ObjectConfig)
    # Number of the simulated person in the population of seed 0, see `sample_person`; 0: the hand of the
    # recording.
    person: int = 0
    glove: WornGloveConfig = dc.field(default_factory=WornGloveConfig)
    operator: OperatorConfig = dc.field(default_factory=OperatorConfig)
    # Further parameters of a person with an intention; grasps do not use them.
    intention: IntentionConfig = dc.field(default_factory=IntentionConfig)
    retargeting: RetargetingConfig = dc.field(default_factory=RetargetingConfig)
    correction: CorrectionConfig = dc.field(default_factory=CorrectionConfig)
    wrist_to_arm: WristToArmConfig = dc.field(default_factory=WristToArmConfig)
    monitor: GraspMonitorConfig = dc.field(default_factory=GraspMonitorConfig)
    recording: RecordingConfig = dc.field(default_factory=RecordingConfig)

    def validate(self) -> None:
        """Checks the values.

        Raises:
            ScenarioError: a field is wrong; the message names it, the rule and the value.
            UnknownNameError: there is no such object or task, or no such kind of person for the task.
        """
        from geort_drake.simulation.tasks import find_task  # which knows scenarios itself

        task = find_task(self.task)
        if self.kind not in task.kinds:
            raise UnknownNameError(f"kind of person for task {task.name}", self.kind, task.kinds)
        for rule, holds, names in _RULES:
            for name in names:
                value = attrgetter(name)(self)
                _require(holds(value), name, rule, value)
        position = self.object.position
        is_point = len(position) == 2 and all(map(math.isfinite, position))
        _require(is_point, "object.position", "[x, y] in m", position)
        try:
            self.glove.validate()
            self.operator.validate()
            self.intention.validate()
            self.correction.validate()
            self.wrist_to_arm.validate()
            self.monitor.validate()
            task.check_settings(self.task_settings)
        except ValueError as error:
            raise ScenarioError(f"scenario field {error}") from error
        try:
            check_timing(self.retargeting.period, self.retargeting.latency, self.retargeting.cutoff)
        except ValueError as error:
            raise ScenarioError(f"scenario field retargeting.{error}") from error
        step = self.plant_config.time_step
        _require(step >= _MIN_TIME_STEP, "plant_config.time_step", f"at least {_MIN_TIME_STEP} s", step)
        try:
            AddMultibodyPlant(self.plant_config, DiagramBuilder())
        except RuntimeError as error:
            raise ScenarioError(f"scenario field plant_config: {error}") from error
        _require(
            self.fingertip_modulus == 0 or self.plant_config.contact_model == "hydroelastic_with_fallback",
            "fingertip_modulus",
            "0 unless plant_config.contact_model is hydroelastic_with_fallback",
            self.fingertip_modulus,
        )
        for name in _PERIODS:
            period = attrgetter(name)(self)
            whole = abs(period / step - round(period / step)) <= 1e-6
            _require(whole, name, f"a multiple of plant_config.time_step ({step} s)", period)
        object_file(self.object.name)


def _require(holds: bool, name: str, rule: str, value: object) -> None:
    if not holds:
        raise ScenarioError(f"scenario field {name} must be {rule}, not {value}")


def object_names() -> list[str]:
    """Returns the names of the objects that come with the package."""
    return sorted(path.stem for path in (models_dir() / "sdf" / "objects").glob("*.sdf"))


def object_file(name: str) -> Path:
    """The model of an object or part; raises UnknownNameError if there is none."""
    for folder in ("objects", "parts"):
        if (path := models_dir() / "sdf" / folder / f"{name}.sdf").is_file():
            return path
    raise UnknownNameError("object", name, object_names())


def default_scenario_file() -> Path:
    """Returns the file of the scenarios that come with the package."""
    return diagrams_dir() / "grasp.scenarios.yaml"


def load_scenario(
    file: str | os.PathLike | None = None,
    name: str = "Grasp",
    text: str | None = None,
    hand: str | None = None,
) -> Scenario:
    """Reads a scenario by name, merges YAML `text` into it, and checks the result.

    Mappings merge and lists replace, as in Drake's hardware_sim. `hand` replaces the scenario's.

    Raises:
        ScenarioError: the file is missing or malformed, or a field is unknown or wrong.
        UnknownNameError: there is no scenario of that name.
    """
    path = Path(file) if file is not None else default_scenario_file()
    if not path.is_file():
        raise ScenarioError(f"scenario file {path} does not exist")
    try:
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ScenarioError(f"scenario file {path} must map names to scenarios: {error}") from error
    if not isinstance(node, yaml.MappingNode):
        raise ScenarioError(f"scenario file {path} must map names to scenarios")
    _refuse_duplicates(node, str(path))
    choices = [key.value for key, _ in node.value]
    if name not in choices:
        raise UnknownNameError(f"scenario in {path}", name, choices)
    scenario = _merged(path, name, text, Scenario())
    scenario.hand = hand or scenario.hand
    scenario.validate()
    return scenario


def names_object(file: str | os.PathLike | None = None, name: str = "Grasp", text: str | None = None) -> bool:
    """Whether a scenario that `load_scenario` accepts, or the text, names an object."""
    path = Path(file) if file is not None else default_scenario_file()
    return bool(_merged(path, name, text, Scenario(object=ObjectConfig(name=""))).object.name)


def _merged(path: Path, name: str, text: str | None, defaults: Scenario) -> Scenario:
    source = f"scenario '{name}' in {path}"
    try:
        scenario = yaml_load_typed(schema=Scenario, filename=str(path), child_name=name, defaults=defaults)
        if text:
            source = f"text merged into {source}"
            _refuse_duplicates(yaml.compose(text, Loader=yaml.SafeLoader), source)
            scenario = yaml_load_typed(schema=Scenario, data=text, defaults=scenario)
    except ScenarioError:
        raise
    except Exception as error:  # Drake's loader raises many types for faulty YAML
        raise ScenarioError(f"{source}: {error}") from error
    return scenario


def _refuse_duplicates(root: yaml.Node | None, source: str) -> None:
    """Raises ScenarioError if a mapping has a key twice; YAML loaders silently take the last one."""
    waiting, seen = [root], set()
    while waiting:
        node = waiting.pop()
        if id(node) in seen:  # an alias may contain itself
            continue
        seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            names = [str(key.value) for key, _ in node.value]
            for name in names:
                if names.count(name) > 1:
                    line = node.start_mark.line + 1
                    raise ScenarioError(
                        f"{source}: '{name}' is given twice in the mapping from line {line} on"
                    )
            waiting.extend(value for _, value in node.value)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)


def parse_scenario(text: str) -> Scenario:
    """Reads the output of `dump_scenario`."""
    return yaml_load_typed(schema=Scenario, data=text, child_name="Resolved", defaults=Scenario())


def scenario_fields(text: str) -> dict:
    """The fields in the output of `dump_scenario` as plain data; tags such as !Rpy are left out."""
    return yaml.load(text, Loader=_Untagged)["Resolved"]


class _Untagged(yaml.SafeLoader):
    """Reads tagged mappings as mappings."""


_Untagged.add_multi_constructor("!", lambda loader, _, node: loader.construct_mapping(node, deep=True))


def dump_scenario(scenario: Scenario) -> str:
    """Returns the whole scenario as YAML that `load_scenario` reads under the name `Resolved`."""
    return yaml_dump_typed(scenario, child_name="Resolved")
