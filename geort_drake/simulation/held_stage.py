"""A stage with a stand that holds a body until the person is ready."""

import dataclasses as dc

from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context, DiagramBuilder

from geort_drake.simulation.task import Stage
from geort_drake.systems.stand import Stand


@dc.dataclass(frozen=True, kw_only=True)
class HeldStage(Stage):
    """A stage whose stand holds a body for `ready_time`, s."""

    stand: Stand
    ready_time: float

    def restart(self, root: Context) -> None:
        super().restart(root)
        self.stand.hold(self.stand.GetMyMutableContextFromRoot(root), root.get_time() + self.ready_time)


def add_stand(
    builder: DiagramBuilder, plant: MultibodyPlant, body: RigidBody, X_WP: RigidTransform, until: float
) -> Stand:
    """Adds a stand and connects it to a finalized plant; arguments as of `Stand`."""
    stand = builder.AddNamedSystem("stand", Stand(body.index(), X_WP, until))
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), stand.GetInputPort(name))
    builder.Connect(stand.get_output_port(), plant.get_applied_spatial_force_input_port())
    return stand
