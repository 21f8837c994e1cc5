"""What pykitti reads of a folder: ``python read.py FOLDER RESULT.json``, in an environment of its own."""

import json
import sys
from pathlib import Path

import pykitti

root, out = sys.argv[1:]


def rounded(values, digits=12):
    return [rounded(value, digits) for value in values] if hasattr(values, "__len__") else round(float(values), digits)


read = pykitti.odometry(str(Path(root) / "odometry"), "03")
odometry = {
    "world_SE3_camera": rounded(read.poses),
    "times_us": [round(time.total_seconds() * 1e6) for time in read.timestamps],
    "intrinsics": {f"image_{n}": rounded(getattr(read.calib, f"K_cam{n}")) for n in range(4)},
    "camera_SE3_lidar": {f"image_{n}": rounded(getattr(read.calib, f"T_cam{n}_velo")) for n in range(4)},
    "files": {f"image_{n}": [Path(file).name for file in getattr(read, f"cam{n}_files")] for n in range(4)},
}
read = pykitti.raw(str(Path(root) / "raw"), "2011_09_26", "0009")
raw = {
    "degrees": [[fix.packet.lon, fix.packet.lat] for fix in read.oxts],
    "height_m": [fix.packet.alt for fix in read.oxts],
    "sigma_m": [fix.packet.pos_accuracy for fix in read.oxts],
    "world_SE3_receiver": rounded([fix.T_w_imu for fix in read.oxts]),
    "times": [time.isoformat() for time in read.timestamps],
    "intrinsics": {f"image_{n:02d}": rounded(getattr(read.calib, f"K_cam{n}")) for n in range(4)},
    "camera_SE3_receiver": {f"image_{n:02d}": rounded(getattr(read.calib, f"T_cam{n}_imu")) for n in range(4)},
    "lidar_SE3_receiver": rounded(read.calib.T_velo_imu),
    "files": {f"image_{n:02d}": [Path(file).name for file in getattr(read, f"cam{n}_files")] for n in range(4)},
}
Path(out).write_text(json.dumps({"odometry": odometry, "raw": raw}, indent=0) + "\n")
