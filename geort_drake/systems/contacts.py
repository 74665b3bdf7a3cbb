"""Contacts between a plant's bodies, from point and hydroelastic contact."""

from collections.abc import Mapping

import numpy as np
from pydrake.geometry import GeometryId, Role, SceneGraphInspector
from pydrake.multibody.plant import ContactResults, MultibodyPlant


def bodies_of_geometries(plant: MultibodyPlant, inspector: SceneGraphInspector) -> dict[GeometryId, int]:
    """Returns the index of the body of every collision geometry."""
    # The plant's own lists of geometries would keep the plant alive.
    bodies = {
        id: plant.GetBodyFromFrameId(inspector.GetFrameId(id))
        for id in inspector.GetAllGeometryIds(Role.kProximity)
    }
    return {id: int(body.index()) for id, body in bodies.items() if body is not None}


def contact_rows(results: ContactResults, bodies: Mapping[GeometryId, int]) -> np.ndarray:
    """Returns contacts as rows (contacts, 8): indices of bodies A and B, p_WC (m), f_Bc_W (N).

    Each pair of geometries in contact has one row. The force is the sum of normal force and friction; for a
    hydroelastic contact surface, it acts at the centroid.

    Args:
        results: contact results of the plant.
        bodies: result of `bodies_of_geometries`.
    """
    points, surfaces = results.num_point_pair_contacts(), results.num_hydroelastic_contacts()
    rows = np.empty((points + surfaces, 8))
    infos = list(map(results.point_pair_contact_info, range(points)))
    if infos:
        rows[:points, 0] = [int(info.bodyA_index()) for info in infos]
        rows[:points, 1] = [int(info.bodyB_index()) for info in infos]
        rows[:points, 2:5] = [info.contact_point() for info in infos]
        rows[:points, 5:] = [info.contact_force() for info in infos]
    for number in range(surfaces):
        info = results.hydroelastic_contact_info(number)
        surface = info.contact_surface()
        row = rows[points + number]
        row[:2] = bodies[surface.id_M()], bodies[surface.id_N()]
        # F_Ac_W acts on the body of M, at the centroid.
        row[2:5], row[5:] = surface.centroid(), -info.F_Ac_W().translational()
    return rows


def contact_geometries(results: ContactResults, row: int) -> tuple[GeometryId, GeometryId]:
    """Returns the two geometries in contact of a row of `contact_rows`."""
    points = results.num_point_pair_contacts()
    if row < points:
        pair = results.point_pair_contact_info(row).point_pair()
        return pair.id_A, pair.id_B
    surface = results.hydroelastic_contact_info(row - points).contact_surface()
    return surface.id_M(), surface.id_N()
