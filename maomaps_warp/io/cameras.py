"""Pinhole cameras from the command line, from calibration files and from camera_info messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from maomaps_warp.errors import InputError
from maomaps_warp.model.camera import Camera

ACCEPTED_FORMS = (
    "WIDTHxHEIGHT@DEGREES of horizontal field of view (320x240@90), WIDTHxHEIGHT:fx,fy,cx,cy, "
    "or a ROS calibration YAML file"
)


def parse_camera(spec: str) -> Camera:
    """The camera that `--camera` names.

    Args:
        spec: "320x240@90" (pixels, horizontal field of view in degrees; square pixels, centred),
            "640x480:525,525,319.5,239.5" (pixels), or the path of a YAML file: a ROS calibration file or the
            output of `rostopic echo` / `ros2 topic echo` of a camera_info topic.

    Raises:
        InputError: none of these forms, impossible numbers, or lens distortion.
    """
    try:
        camera = Camera.from_text(spec)
    except (ValueError, OverflowError) as error:
        raise InputError(f"camera {spec!r}", str(error), f"allowed: {ACCEPTED_FORMS}") from None
    if camera is not None:
        return camera
    path = Path(spec)
    if not path.is_file():
        raise InputError(f"camera {spec!r}", "neither a camera nor a file", f"allowed: {ACCEPTED_FORMS}")
    return _read_calibration(path)


def camera_from_info(message: Any, where: object) -> Camera:
    """The camera of a sensor_msgs/CameraInfo, of ROS 1 (fields K, D) or ROS 2 (k, d).

    Args:
        message: an object with width, height, the 9 numbers K (row-major) and the distortion coefficients D.
        where: file and topic, for messages.

    Raises:
        InputError: K is all zeros (not calibrated), has skew, the image is distorted, binned or cropped.
    """
    matrix = _numbers(_field(message, "k"), where, "K")
    distortion = _numbers(_field(message, "d"), where, "D")
    if len(matrix) != 9:
        raise InputError(where, f"K has {len(matrix)} numbers", "a camera matrix has 9")
    if not any(matrix):
        raise InputError(where, "K is all zeros: the camera is not calibrated", f"give --camera: {ACCEPTED_FORMS}")
    if any(distortion):
        raise InputError(
            where,
            f"lens distortion {', '.join(f'{value:g}' for value in distortion)}",
            "rectify the images first, or give the rectified camera with --camera",
        )
    fx, skew, cx, _, fy, cy, *_ = matrix
    if skew:
        raise InputError(where, f"K has a skew of {skew:g}", "rectify the images first, or give --camera")
    _refuse_binning(message, where)
    size = _numbers((_field(message, "width"), _field(message, "height")), where, "image size")
    return _built(lambda: Camera(int(size[0]), int(size[1]), fx, fy, cx, cy), where)


def _refuse_binning(message: Any, where: object) -> None:
    """K describes the full image; a binned or cropped one would need another."""
    binning = [getattr(message, name, 0) for name in ("binning_x", "binning_y")]
    roi = getattr(message, "roi", None)
    crop = [getattr(roi, name, 0) for name in ("x_offset", "y_offset", "width", "height")]
    left, top, width, height = _numbers(crop, where, "roi")
    cropped = left or top or width not in (0, message.width) or height not in (0, message.height)
    if max(_numbers(binning, where, "binning")) > 1 or cropped:
        raise InputError(where, "the images are binned or cropped", "give their own intrinsics with --camera")


def _read_calibration(path: Path) -> Camera:
    """The camera of a YAML file: a ROS calibration file, or an echoed camera_info message."""
    document = _first_yaml_document(path)
    if not isinstance(document, Mapping):
        raise InputError(path, "not a camera calibration", f"allowed: {ACCEPTED_FORMS}")
    if "camera_matrix" in document:
        distortion = document.get("distortion_coefficients")
        fields = {
            "width": document.get("image_width"),
            "height": document.get("image_height"),
            "k": _matrix_data(document["camera_matrix"]),
            "d": [] if distortion is None else _matrix_data(distortion),
        }
    else:
        fields = {key: document.get(key, document.get(key.upper())) for key in ("width", "height", "k", "d")}
        roi = document.get("roi")
        crop = {str(key): value for key, value in roi.items()} if isinstance(roi, Mapping) else {}
        fields["roi"] = SimpleNamespace(**crop)
        fields["binning_x"], fields["binning_y"] = document.get("binning_x", 0), document.get("binning_y", 0)
    missing = [name for name in ("width", "height", "k") if fields[name] is None]
    if missing:
        raise InputError(
            path,
            f"no {', '.join(missing)}",
            "a calibration file has image_width, image_height and camera_matrix; an echoed camera_info has "
            "width, height and K or k",
        )
    return camera_from_info(SimpleNamespace(**fields), path)


def _first_yaml_document(path: Path) -> object:
    """The first document of a YAML file; `rostopic echo` ends each message with a document separator."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        text = path.read_text(encoding="utf-8")
        return next(iter(YAML(typ="safe").load_all(text)), None)
    except (OSError, UnicodeDecodeError, YAMLError, ValueError) as error:
        first_line = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(path, f"not a YAML file: {first_line}", f"allowed: {ACCEPTED_FORMS}") from error


def _matrix_data(entry: object) -> object:
    return entry.get("data") if isinstance(entry, Mapping) else entry


def _field(message: Any, name: str) -> Any:
    """A field of camera_info, which ROS 1 writes K and D, ROS 2 k and d."""
    return getattr(message, name) if hasattr(message, name) else getattr(message, name.upper(), None)


def _numbers(values: object, where: object, name: str) -> list[float]:
    """`values` as floats; an absent list is empty."""
    if values is None:
        return []
    try:
        if not isinstance(values, Iterable):
            raise TypeError("not a list")
        return [float(value) for value in values]
    except (TypeError, ValueError) as error:
        raise InputError(where, f"{name} is not a list of numbers: {error}") from error


def _built(build: Any, where: object) -> Camera:
    """`build()`, its complaints about impossible numbers made a user's error."""
    try:
        camera: Camera = build()
    except (ValueError, OverflowError) as error:
        raise InputError(where, str(error), f"allowed: {ACCEPTED_FORMS}") from error
    return camera
