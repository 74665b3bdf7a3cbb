"""Contacts between a plant's bodies, from point and hydroelastic contact."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from pydrake.geometry import GeometryId
from pydrake.multibody.plant import ContactResults, MultibodyPlant, PointPairContactInfo
from pydrake.multibody.tree import BodyIndex

# A PointPairContactInfo or HydroelasticContactInfo; for type checkers, pydrake's templates are no types.
ContactInfo: TypeAlias = Any


def bodies_of_geometries(plant: MultibodyPlant) -> dict[GeometryId, int]:
    """Returns the index of the body of every collision geometry."""
    bodies = map(plant.get_body, map(BodyIndex, range(plant.num_bodies())))
    return {id: int(body.index()) for body in bodies for id in plant.GetCollisionGeometriesForBody(body)}


def contact_infos(results: ContactResults) -> list[ContactInfo]:
    """Returns all contacts: each pair of geometries in point contact, then each hydroelastic surface."""
    points, surfaces = results.num_point_pair_contacts(), results.num_hydroelastic_contacts()
    infos = list(map(results.point_pair_contact_info, range(points)))
    return infos + list(map(results.hydroelastic_contact_info, range(surfaces)))


def contact_bodies(info: ContactInfo, bodies: Mapping[GeometryId, int]) -> tuple[int, int]:
    """Returns the indices of bodies A and B; `bodies` is the result of `bodies_of_geometries`."""
    if isinstance(info, PointPairContactInfo):
        return int(info.bodyA_index()), int(info.bodyB_index())
    A, B = contact_geometries(info)
    return bodies[A], bodies[B]


def contact_geometries(info: ContactInfo) -> tuple[GeometryId, GeometryId]:
    """Returns the two geometries in contact."""
    if isinstance(info, PointPairContactInfo):
        pair = info.point_pair()
        return pair.id_A, pair.id_B
    surface = info.contact_surface()
    return surface.id_M(), surface.id_N()


def contact_point(info: ContactInfo) -> np.ndarray:
    """Returns p_WC (3,), m; the centroid of a hydroelastic contact surface."""
    if isinstance(info, PointPairContactInfo):
        return info.contact_point()
    return info.contact_surface().centroid()


def contact_force(info: ContactInfo) -> np.ndarray:
    """Returns f_Bc_W (3,), N: the sum of normal force and friction, which acts at `contact_point`."""
    if isinstance(info, PointPairContactInfo):
        return info.contact_force()
    # F_Ac_W acts on the body of the surface's geometry M, which is A.
    return -info.F_Ac_W().translational()


def contact_rows(results: ContactResults, bodies: Mapping[GeometryId, int]) -> np.ndarray:
    """Returns contacts as rows (contacts, 8): bodies A and B, point and force as from the functions above."""
    infos = contact_infos(results)
    rows = np.empty((len(infos), 8))
    if infos:
        rows[:, :2] = [contact_bodies(info, bodies) for info in infos]
        rows[:, 2:5] = list(map(contact_point, infos))
        rows[:, 5:] = list(map(contact_force, infos))
    return rows
