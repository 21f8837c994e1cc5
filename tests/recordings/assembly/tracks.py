"""A track in GPX: three points, one of them without a time."""

GPX = """<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
<trkpt lat="52.5" lon="13.4"><ele>40.5</ele><time>2026-03-01T10:00:00Z</time></trkpt>
<trkpt lat="52.5001" lon="13.4"><ele>41</ele><geoidheight>39.5</geoidheight>
<time>2026-03-01T12:00:00.250+02:00</time></trkpt>
<trkpt lat="52.5002" lon="13.4"><ele>41</ele></trkpt>
</trkseg></trk></gpx>
"""
