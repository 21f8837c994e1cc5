"""Field lists of the ROS 2 messages that the reader decodes, for databases that hold no message definitions."""

from __future__ import annotations

from typing import Final

_TIME: Final = "int32 sec\nuint32 nanosec\n"
_HEADER: Final = "builtin_interfaces/Time stamp\nstring frame_id\n"
_POINT: Final = "float64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION: Final = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
_POSE: Final = "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"

_FIELDS: Final = {
    "builtin_interfaces/Time": _TIME,
    "std_msgs/Header": _HEADER,
    "geometry_msgs/Point": _POINT,
    "geometry_msgs/Vector3": _POINT,
    "geometry_msgs/Quaternion": _QUATERNION,
    "geometry_msgs/Pose": _POSE,
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n",
    "nav_msgs/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "sensor_msgs/NavSatStatus": "int8 status\nuint16 service\n",
    "sensor_msgs/NavSatFix": (
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n"
        "float64 altitude\nfloat64[9] position_covariance\nuint8 position_covariance_type\n"
    ),
    "sensor_msgs/Imu": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data\n",
    "sensor_msgs/RegionOfInterest": (
        "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n"
    ),
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
        "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n"
    ),
    "foxglove_msgs/CompressedVideo": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n"
    ),
}


def definition_of(kind: str) -> str | None:
    """Return the definition of a message type with all types that it contains, in the format ``ros2msg``.

    Args:
        kind: e.g. ``sensor_msgs/msg/NavSatFix``.

    Returns:
        The definition; None: the reader does not know the type.
    """
    name = kind.replace("/msg/", "/")
    if name not in _FIELDS:
        return None
    contained = [name]
    for one in contained:
        for line in _FIELDS[one].splitlines():
            part = line.split()[0].partition("[")[0]
            if part in _FIELDS and part not in contained:
                contained.append(part)
    separator = "=" * 80
    return "".join(_FIELDS[one] if one == name else f"{separator}\nMSG: {one}\n{_FIELDS[one]}" for one in contained)
