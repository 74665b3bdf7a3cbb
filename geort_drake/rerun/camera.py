"""Cameras in a Rerun recording: pictures, and where they were taken from."""

import io
from collections.abc import Sequence

import numpy as np
import rerun as rr
from PIL import Image
from pydrake.math import RigidTransform
from pydrake.systems.sensors import ImageRgba8U, RgbdSensor

from geort_drake.rerun.scene import WORLD, entity_path
from geort_drake.rerun.tracks import Track, quaternions
from geort_drake.rerun.writer import Writer

_QUALITY = 85  # of JPEG; a tenth of the size of PNG
_PLANE = 0.15  # m; how far before the camera its picture hangs in the scene


class CameraTrack(Track):
    """Colour pictures of a Drake camera: rows (JPEG, X_WC), C the colour camera, z ahead and y down."""

    large = True

    def __init__(self, key: str, sensor: RgbdSensor, period: float):
        super().__init__(f"{key}/color_image", f"{key}/body_pose", period=period)
        self.key = key
        core = sensor.default_color_render_camera().core()
        self._intrinsics = core.intrinsics()
        self._X_BC = core.sensor_pose_in_camera_body()

    def path(self) -> str:
        return entity_path(WORLD, self.key)

    def read(self, image: ImageRgba8U, X_WB: RigidTransform) -> tuple[bytes, np.ndarray]:
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(image.data[..., :3])).save(file, "JPEG", quality=_QUALITY)
        return file.getvalue(), (X_WB @ self._X_BC).GetAsMatrix34()

    def describe(self, writer: Writer) -> None:
        optics = self._intrinsics
        pinhole = rr.Pinhole(
            image_from_camera=optics.intrinsic_matrix(),
            resolution=[optics.width(), optics.height()],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=_PLANE,
        )
        writer.static(self.path(), pinhole)

    def write(self, writer: Writer, rows: Sequence[tuple[bytes, np.ndarray] | None]) -> None:
        taken = np.array([i for i, row in enumerate(rows) if row is not None], dtype=int)
        pictures = [row for row in rows if row is not None]
        if not pictures:
            return
        X_WC = np.array([pose for _, pose in pictures])
        columns = rr.Transform3D.columns(translation=X_WC[:, :, 3], quaternion=quaternions(X_WC[:, :, :3]))
        writer.columns(self.path(), columns, taken)
        jpegs = rr.EncodedImage.columns(
            blob=[jpeg for jpeg, _ in pictures], media_type=["image/jpeg"] * len(pictures)
        )
        writer.columns(self.path(), jpegs, taken)
