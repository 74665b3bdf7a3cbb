"""Records the images of a camera."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from PIL import Image
from pydrake.math import RigidTransform
from pydrake.systems.framework import OutputPort
from pydrake.systems.sensors import ImageRgba8U, RgbdSensor

from geort_drake.rerun.specs import Spec
from geort_drake.rerun.writer import WORLD, Writer, entity_path

_JPEG_QUALITY = 85  # a tenth of the size of PNG
_IMAGE_DISTANCE = 0.15  # m, from the camera to its image in the scene


@dataclass(frozen=True)
class CameraSpec(Spec):
    """Records a camera's colour images as JPEG, and its pose X_WC with z forward and y down in C.

    Attributes:
        sensor: the camera; rendering its images takes far longer than everything else.
        period: time between images, s; at least the recorder's period.
    """

    sensor: RgbdSensor
    period: float = 0.1

    def ports(self, key: str, plant_port: Callable[[str], OutputPort]) -> dict[str, OutputPort]:
        return {
            f"{key}/color_image": self.sensor.color_image_output_port(),
            f"{key}/body_pose": self.sensor.body_pose_in_world_output_port(),
        }

    def read(self, image: ImageRgba8U, X_WB: RigidTransform) -> tuple[bytes, np.ndarray]:
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(image.data[..., :3])).save(file, "JPEG", quality=_JPEG_QUALITY)
        X_BC = self.sensor.default_color_render_camera().core().sensor_pose_in_camera_body()
        return file.getvalue(), (X_WB @ X_BC).GetAsMatrix34()

    def write(self, writer: Writer, key: str, rows: Sequence[tuple[bytes, np.ndarray] | None]) -> None:
        path, optics = entity_path(WORLD, key), self.sensor.default_color_render_camera().core().intrinsics()
        pinhole = rr.Pinhole(
            image_from_camera=optics.intrinsic_matrix(),
            resolution=[optics.width(), optics.height()],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=_IMAGE_DISTANCE,
        )
        writer.static(path, pinhole)
        X_WC = np.array([np.full((3, 4), np.nan) if row is None else row[1] for row in rows])
        writer.poses([path], X_WC.reshape(-1, 1, 3, 4))
        taken = np.array([i for i, row in enumerate(rows) if row is not None], dtype=int)
        images = [row[0] for row in rows if row is not None]
        columns = rr.EncodedImage.columns(blob=images, media_type=["image/jpeg"] * len(images))
        writer.columns(path, columns, taken)
