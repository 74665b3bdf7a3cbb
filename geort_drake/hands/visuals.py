"""Shapes that are only seen, in contexts in which nobody looks."""

from pydrake.geometry import Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context


def forget_visuals(plant: MultibodyPlant, scene_graph: SceneGraph, root: Context) -> None:
    """Leaves in a diagram's context what can touch, because all the rest would be placed anew at each step.

    The model keeps them.
    """
    context = scene_graph.GetMyMutableContextFromRoot(root)
    inspector = scene_graph.get_query_output_port().Eval(context).inspector()
    touching = set(inspector.GetAllGeometryIds(Role.kProximity))
    for geometry in inspector.GetAllGeometryIds():
        if geometry not in touching:
            scene_graph.RemoveGeometry(context, plant.get_source_id(), geometry)
