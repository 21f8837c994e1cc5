"""What mapillary_tools reads of videos: ``python read.py FOLDER RESULT.json``, in an environment of its own."""

import json
import sys
from pathlib import Path

from mapillary_tools.camm.camm_parser import extract_camm_info
from mapillary_tools.gpmf.gpmf_parser import extract_gopro_info

root, out = sys.argv[1:]
videos = {}
for file in sorted(Path(root).iterdir()):
    with file.open("rb") as opened:
        if file.stem.startswith("camm"):
            info = extract_camm_info(opened)
            fixes = info.gps or info.mini_gps
        else:
            fixes = extract_gopro_info(opened).gps
    videos[file.stem] = {
        "media_s": [fix.time for fix in fixes],
        "degrees": [[fix.lon, fix.lat, fix.alt] for fix in fixes],
        "unix_s": [getattr(fix, "epoch_time", getattr(fix, "time_gps_epoch", None)) for fix in fixes],
    }
Path(out).write_text(json.dumps(videos) + "\n")
