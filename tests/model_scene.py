"""Models in a plant, for the tests of models/sdf."""

from pathlib import Path

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder

from geort_drake.resources import models_dir

SDF_FILES = sorted((models_dir() / "sdf").rglob("*.sdf"))
# By name, as whoever adds a hand of their own has it in models/hands too.
SHIPPED_HANDS = ("allegro_left", "allegro_right", "leap_right")
OBJECTS = sorted((models_dir() / "sdf" / "objects").glob("*.sdf"))


class Scene:
    """Models in a finalized discrete plant; the first link of each named file is welded to the world."""

    def __init__(self, *paths: Path, welded: tuple[str, ...] = ()):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=0.002, discrete_contact_approximation="sap")
        self.plant, self.scene_graph = AddMultibodyPlant(config, builder)
        parser = Parser(self.plant)
        # A model that reaches for something outside the package, or that Drake only half understands, fails.
        parser.SetStrictParsing()
        for path in paths:
            parser.AddModels(path)
        for link in welded:
            self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName(link))
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)

    def set_joints(self, positions: dict[str, float]) -> None:
        for name, value in positions.items():
            self.plant.GetJointByName(name).set_angle(self.context, value)

    def collides(self) -> bool:
        return self.plant.get_geometry_query_input_port().Eval(self.context).HasCollisions()
