"""Makes ROS messages: of ROS 1 (Noetic) and of ROS 2."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.pcd import FLOAT32_REACH_M
from maomaps_warp.io.stamp_order import seconds_text
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.occupancy import Cell, OccupancyGrid

#: A ROS 1 bag, a lone MCAP file with ROS 2 messages, a ROS 2 folder.
BagKind = Literal["ros1", "mcap", "ros2"]

#: First second that the stamps of a ROS version cannot hold: unsigned 32 bits in ROS 1, signed ones in ROS 2 (2038).
_END_OF_TIME_S = {"ros1": 1 << 32, "mcap": 1 << 31, "ros2": 1 << 31}

#: sensor_msgs/PointField FLOAT32.
_FLOAT32 = 7
#: nav_msgs/OccupancyGrid: -1 unknown, else per cent of being occupied.
_CELL_VALUES = {Cell.UNKNOWN: -1, Cell.FREE: 0, Cell.OCCUPIED: 100}


@dataclass(frozen=True)
class MessageMaker:
    """Makes messages of one ROS version.

    Attributes:
        kind: of the bag that they are for.
        store: the message types, by which they are serialised.
    """

    kind: BagKind
    store: Any

    @classmethod
    def of(cls, kind: BagKind) -> MessageMaker:
        """The maker for a kind of bag."""
        from rosbags.typesys import Stores, get_typestore

        # Humble: the oldest ROS 2 release in use; these messages are the same in all later ones.
        return cls(kind, get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE))

    def header(self, stamp_ns: int, frame_id: str, seq: int = 0) -> Any:
        """std_msgs/Header; `seq` counts a topic's messages, in ROS 1 only.

        Raises:
            InputError: a stamp that is not above zero (which means "not set") or beyond what ROS can hold.
        """
        number = {"seq": seq} if self.kind == "ros1" else {}
        return self._type("std_msgs/msg/Header")(stamp=self._time(stamp_ns), frame_id=frame_id, **number)

    def image(self, header: Any, encoding: str, pixels: NDArray[Any]) -> Any:
        """sensor_msgs/Image of (H, W) or (H, W, C) pixels of an encoding ("rgb8", "32FC1")."""
        data = np.ascontiguousarray(pixels)
        return self._type("sensor_msgs/msg/Image")(
            header=header,
            height=data.shape[0],
            width=data.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=data.strides[0],
            data=data.reshape(-1).view(np.uint8),
        )

    def camera_info(self, header: Any, camera: Camera) -> Any:
        """sensor_msgs/CameraInfo of a pinhole camera without distortion."""
        row_x, row_y = [camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy]
        matrices = {
            "D": np.zeros(5),
            "K": np.array([*row_x, *row_y, 0.0, 0.0, 1.0]),
            "R": np.eye(3).reshape(-1),
            "P": np.array([*row_x, 0.0, *row_y, 0.0, 0.0, 0.0, 1.0, 0.0]),
        }
        # ROS 2 names these fields in small letters.
        named = matrices if self.kind == "ros1" else {name.lower(): value for name, value in matrices.items()}
        return self._type("sensor_msgs/msg/CameraInfo")(
            header=header,
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=self._type("sensor_msgs/msg/RegionOfInterest")(0, 0, 0, 0, False),
            **named,
        )

    def pose_stamped(self, header: Any, position: Sequence[float], xyzw: Sequence[float]) -> Any:
        """geometry_msgs/PoseStamped of a position, metres, and a unit quaternion."""
        return self._type("geometry_msgs/msg/PoseStamped")(header=header, pose=self._pose(position, xyzw))

    def string(self, text: str) -> Any:
        """std_msgs/String."""
        return self._type("std_msgs/msg/String")(data=text)

    def path(self, header: Any, poses: Sequence[Any]) -> Any:
        """nav_msgs/Path of PoseStamped messages."""
        return self._type("nav_msgs/msg/Path")(header=header, poses=list(poses))

    def point_cloud(self, header: Any, cloud: PointCloud) -> Any:
        """sensor_msgs/PointCloud2 of float32 x, y, z, and 0x00RRGGBB in a float `rgb` where there are colours, as PCL.

        Raises:
            InputError: a coordinate exceeds FLOAT32_REACH_M: float32 would move points by more than 0.5 mm.
        """
        far = np.flatnonzero(np.abs(cloud.points).max(axis=1) > FLOAT32_REACH_M)
        if len(far):
            place = " ".join(f"{value:.10g}" for value in cloud.points[far[0]])
            found = f"point {far[0] + 1} lies at {place} m; {len(far)} of {len(cloud)} points lie so far out"
            hint = f"PointCloud2 resolves 1 mm up to {FLOAT32_REACH_M:g} m: move the cloud with `transform` first"
            raise InputError(cloud.source, found, hint)
        names = ("x", "y", "z") if cloud.colors is None else ("x", "y", "z", "rgb")
        records = np.empty((len(cloud), len(names)), "<u4")
        records[:, :3] = cloud.points.astype("<f4").view("<u4")
        if cloud.colors is not None:
            red, green, blue = cloud.colors.astype(np.uint32).T
            records[:, 3] = (red << 16) | (green << 8) | blue
        field = self._type("sensor_msgs/msg/PointField")
        return self._type("sensor_msgs/msg/PointCloud2")(
            header=header,
            height=1,
            width=len(cloud),
            fields=[field(name, 4 * i, _FLOAT32, 1) for i, name in enumerate(names)],
            is_bigendian=False,
            point_step=4 * len(names),
            row_step=4 * len(names) * len(cloud),
            data=records.reshape(-1).view(np.uint8),
            is_dense=True,
        )

    def occupancy_grid(self, header: Any, grid: OccupancyGrid) -> Any:
        """nav_msgs/OccupancyGrid: -1 unknown, 0 free, 100 occupied."""
        x, y, yaw = grid.origin
        values = np.zeros(256, np.int8)
        for kind, value in _CELL_VALUES.items():
            values[kind] = value
        info = self._type("nav_msgs/msg/MapMetaData")(
            map_load_time=header.stamp,
            resolution=grid.resolution,
            width=grid.cells.shape[1],
            height=grid.cells.shape[0],
            origin=self._pose((x, y, 0.0), (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))),
        )
        return self._type("nav_msgs/msg/OccupancyGrid")(header=header, info=info, data=values[grid.cells].reshape(-1))

    def _type(self, name: str) -> Any:
        return self.store.types[name]

    def _time(self, stamp_ns: int) -> Any:
        end = _END_OF_TIME_S[self.kind]
        if not 0 < stamp_ns < end * 10**9:
            found = "is no time that a message can bear"
            raise InputError(f"stamp {seconds_text(stamp_ns)} s", found, f"stamps lie above 0 and below {end} s")
        return self._type("builtin_interfaces/msg/Time")(stamp_ns // 10**9, stamp_ns % 10**9)

    def _pose(self, position: Sequence[float], xyzw: Sequence[float]) -> Any:
        return self._type("geometry_msgs/msg/Pose")(
            position=self._type("geometry_msgs/msg/Point")(*position),
            orientation=self._type("geometry_msgs/msg/Quaternion")(*xyzw),
        )
