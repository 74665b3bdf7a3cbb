"""What to simulate, as data: the schema of `diagrams/*.scenarios.yaml` and how it is read.

This module must not use postponed annotations, because Drake's YAML loader reads the types.
"""

import dataclasses as dc
import math
import os
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.multibody.parsing import ModelDirective
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError, UnknownNameError
from geort_drake.resources import diagrams_dir, models_dir
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.tasks.grasp.monitor import GraspMonitorConfig
from geort_drake.systems.action_correction import CorrectionConfig
from geort_drake.systems.update_timing import check_timing
from geort_drake.systems.wrist_to_arm import WristToArmConfig

MIN_TIME_STEP = 1e-5  # s


@dc.dataclass
class ObjectConfig:
    """The object to grasp, and how its placement varies with the seed."""

    # Stem of a file in models/sdf/objects.
    name: str = "cylinder"
    # Centre of the placement in W, x and y, m; the object stands on `support_height`.
    position: list[float] = dc.field(default_factory=lambda: [0.5, 0.0])
    # Height in W of what the object stands on, m.
    support_height: float = 0.1
    # Yaw in W, rad, and factors on the model's mass and on its friction coefficients.
    yaw: float = 0.0
    mass_factor: float = 1.0
    friction_factor: float = 1.0
    # Largest deviation from the centre in x and y, m, and from that yaw, rad.
    position_range: float = 0.02
    yaw_range: float = 0.35
    # Mass and friction are scaled further by factors drawn between 1 - this and 1 + this.
    mass_range: float = 0.2
    friction_range: float = 0.2


@dc.dataclass
class RetargetingConfig:
    """How the retargeter runs in the diagram."""

    # Time between updates, s, and the speed limit of the joint targets, rad/s.
    period: float = 0.01
    max_joint_speed: float = 7.0
    # Their acceleration limit, rad/s², and the cutoff of a low-pass on them, Hz; 0 is none.
    max_joint_acceleration: float = 700.0
    cutoff: float = 0.0
    # How long the retargeter takes, s, rounded up to whole steps of the plant: its joint targets come so
    # much later, and it is not called again before.
    latency: float = 0.0


@dc.dataclass
class RecordingConfig:
    """What is recorded for the Rerun viewer."""

    # Time between recorded frames, s.
    period: float = 0.02
    # Draw Panda and right Allegro in the meshes of Drake's public models (`drake_models`), which Drake
    # downloads where ROS_PACKAGE_PATH names no copy of them.
    public_meshes: bool = False


@dc.dataclass
class Scenario:
    """One grasp trial: the world, the person, and the chain between them."""

    # Seed of the object's placement, mass and friction, and of the person's noise.
    random_seed: int = 0
    # The trial fails when it is not over by then, s.
    timeout: float = 25.0
    # Plant settings; SAP with point contact, at a step that divides the other periods. Output ports that are
    # not sampled are computed when they are read, instead of all of them at each step.
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
    # Description of the robot hand: a stem in models/hands, or a path. Its model is added as `hand`, where
    # the directives have not.
    hand: str = "allegro_right"
    # Frame of the directives' models that carries the hand, which the hand's `mount` is relative to.
    hand_parent: str = "adapter::hand_side"
    # Factor on the proportional gains of the hand's controllers; the derivative gains go with its root,
    # which leaves the damping ratio as it is.
    hand_stiffness_factor: float = 1.0
    # Whether the arm stays where it starts, so that the hand is on a fixed base: for replays, which then need
    # no wrist poses.
    fixed_base: bool = False
    # Joint positions of the arm at the start, by name, rad; and with a left hand, where these differ.
    arm_posture: dict[str, float] = dc.field(default_factory=dict)
    left_arm_posture: dict[str, float] = dc.field(default_factory=dict)
    object: ObjectConfig = dc.field(default_factory=ObjectConfig)
    operator: OperatorConfig = dc.field(default_factory=OperatorConfig)
    retargeting: RetargetingConfig = dc.field(default_factory=RetargetingConfig)
    correction: CorrectionConfig = dc.field(default_factory=CorrectionConfig)
    wrist_to_arm: WristToArmConfig = dc.field(default_factory=WristToArmConfig)
    monitor: GraspMonitorConfig = dc.field(default_factory=GraspMonitorConfig)
    recording: RecordingConfig = dc.field(default_factory=RecordingConfig)

    def validate(self) -> None:
        """Checks what the types cannot say.

        Raises:
            ScenarioError: naming the field, what was wanted and what was given.
            UnknownNameError: the object's name stands for no model.
        """
        for name, value in {
            "timeout": self.timeout,
            "plant_config.time_step": self.plant_config.time_step,
            "retargeting.period": self.retargeting.period,
            "retargeting.max_joint_speed": self.retargeting.max_joint_speed,
            "retargeting.max_joint_acceleration": self.retargeting.max_joint_acceleration,
            "recording.period": self.recording.period,
            "hand_stiffness_factor": self.hand_stiffness_factor,
            "object.mass_factor": self.object.mass_factor,
            "object.friction_factor": self.object.friction_factor,
        }.items():
            if not (math.isfinite(value) and value > 0):
                raise ScenarioError(f"scenario field {name} must be positive, not {value}")
        if self.plant_config.time_step < MIN_TIME_STEP:
            raise ScenarioError(
                f"scenario field plant_config.time_step must be at least {MIN_TIME_STEP} s, or a trial "
                f"would hardly end; it is {self.plant_config.time_step}"
            )
        try:
            self.operator.validate()
            self.correction.validate()
            self.wrist_to_arm.validate()
            self.monitor.validate()
        except ValueError as error:
            raise ScenarioError(f"scenario field {error}") from error
        try:
            AddMultibodyPlant(self.plant_config, DiagramBuilder())
        except RuntimeError as error:
            raise ScenarioError(f"scenario field plant_config: {error}") from error
        try:
            check_timing(self.retargeting.period, self.retargeting.latency, self.retargeting.cutoff)
        except ValueError as error:
            raise ScenarioError(f"scenario field retargeting.{error}") from error
        if self.random_seed < 0:
            raise ScenarioError(f"scenario field random_seed must be 0 or more, not {self.random_seed}")
        if len(self.object.position) != 2 or not all(map(math.isfinite, self.object.position)):
            raise ScenarioError(
                f"scenario field object.position must be [x, y] in m, not {self.object.position}"
            )
        for name in ("support_height", "yaw"):
            value = getattr(self.object, name)
            if not math.isfinite(value):
                raise ScenarioError(f"scenario field object.{name} must be finite, not {value}")
        for name in ("position_range", "yaw_range"):
            value = getattr(self.object, name)
            if not (math.isfinite(value) and value >= 0):
                raise ScenarioError(
                    f"scenario field object.{name} must be finite and not negative, not {value}"
                )
        for name in ("mass_range", "friction_range"):
            value = getattr(self.object, name)
            if not 0 <= value < 1:
                raise ScenarioError(f"scenario field object.{name} must be in [0, 1), not {value}")
        step = self.plant_config.time_step
        for name, period in {
            "retargeting.period": self.retargeting.period,
            "wrist_to_arm.period": self.wrist_to_arm.period,
            "operator.period": self.operator.period,
            "monitor.period": self.monitor.period,
            "recording.period": self.recording.period,
        }.items():
            if abs(period / step - round(period / step)) > 1e-6:
                raise ScenarioError(
                    f"scenario field {name} ({period} s) must be a multiple of plant_config.time_step "
                    f"({step} s)"
                )
        if self.object.name not in object_names():
            raise UnknownNameError("object", self.object.name, object_names())


def object_names() -> list[str]:
    """Names of the objects that come with the package."""
    return sorted(path.stem for path in (models_dir() / "sdf" / "objects").glob("*.sdf"))


def default_scenario_file() -> Path:
    """The scenarios that come with the package."""
    return diagrams_dir() / "grasp.scenarios.yaml"


def load_scenario(
    file: str | os.PathLike | None = None,
    name: str = "Grasp",
    text: str | None = None,
    hand: str | None = None,
) -> Scenario:
    """Reads a scenario by name, then merges YAML `text` into it, and checks the result.

    Mappings merge and lists replace, as in Drake's hardware_sim. `hand` takes the place of the scenario's.

    Raises:
        ScenarioError: the file is missing or malformed, or a field is unknown or wrong.
        UnknownNameError: there is no scenario of that name.
    """
    path = Path(file) if file is not None else default_scenario_file()
    if not path.is_file():
        raise ScenarioError(f"scenario file {path} does not exist")
    try:
        with path.open(encoding="utf-8") as stream:
            node = yaml.compose(stream, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ScenarioError(f"scenario file {path} is no mapping of names to scenarios: {error}") from error
    if not isinstance(node, yaml.MappingNode):
        raise ScenarioError(f"scenario file {path} is no mapping of names to scenarios")
    _check_unique(node, str(path))
    choices = [key.value for key, _ in node.value]
    if name not in choices:
        raise UnknownNameError(f"scenario in {path}", name, choices)
    source = f"scenario '{name}' in {path}"
    try:
        scenario = yaml_load_typed(schema=Scenario, filename=str(path), child_name=name, defaults=Scenario())
        if text:
            source = f"text merged into {source}"
            _check_unique(yaml.compose(text, Loader=yaml.SafeLoader), source)
            scenario = yaml_load_typed(schema=Scenario, data=text, defaults=scenario)
    except ScenarioError:
        raise
    except Exception as error:  # Drake's loader raises many types; all mean the YAML is at fault
        raise ScenarioError(f"{source}: {error}") from error
    scenario.hand = hand or scenario.hand
    scenario.validate()
    return scenario


def names_object(file: str | os.PathLike | None = None, name: str = "Grasp", text: str | None = None) -> bool:
    """Whether the scenario, or the text merged into it, says what to grasp.

    The arguments are those of `load_scenario`, which has taken them before.
    """
    path = Path(file) if file is not None else default_scenario_file()
    scenarios = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    given = (_field(scenarios, name), yaml.compose(text or "", Loader=yaml.SafeLoader))
    return any(_field(_field(fields, "object"), "name") is not None for fields in given)


def _field(node: yaml.Node | None, name: str) -> yaml.Node | None:
    """A field of a mapping, which may come from another one that is merged into it by `<<`."""
    if isinstance(node, yaml.SequenceNode):
        return next(filter(None, (_field(mapping, name) for mapping in node.value)), None)
    if not isinstance(node, yaml.MappingNode):
        return None
    fields = {key.value: value for key, value in node.value}
    return fields[name] if name in fields else _field(fields.get("<<"), name)


def _check_unique(root: yaml.Node | None, source: str) -> None:
    """Raises ScenarioError if a field is given twice, of which YAML would take the last without a word."""
    waiting, seen = [root], set()
    while waiting:
        node = waiting.pop()
        if id(node) in seen:  # an alias may stand for what holds it
            continue
        seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            names = [str(key.value) for key, _ in node.value]
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                line = node.start_mark.line + 1
                raise ScenarioError(
                    f"{source}: '{twice[0]}' is given twice in the mapping from line {line} on"
                )
            waiting.extend(value for _, value in node.value)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)


def parse_scenario(text: str) -> Scenario:
    """The scenario that `dump_scenario` wrote."""
    return yaml_load_typed(schema=Scenario, data=text, child_name="Resolved", defaults=Scenario())


def dump_scenario(scenario: Scenario) -> str:
    """The whole scenario as YAML that `load_scenario` reads under the name `Resolved`."""
    return yaml_dump_typed(scenario, child_name="Resolved")
