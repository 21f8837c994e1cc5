"""Lines of a map in clips: their files, where they are drawn, and the networks that take them."""

from __future__ import annotations

import io
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.folder import clip_path, headers_of, read_clip, write_clip
from hybridworldsim.generation.clips.map_lines import MapLine, crop_lines, move_lines
from hybridworldsim.generation.clips.road_map import lines_of_map
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions, roll_out_clip
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.layout.boxes import OPENDWM_STYLE, OWN_STYLE
from hybridworldsim.generation.layout.images import draw_frame_layout, takes_map
from hybridworldsim.generation.layout.map_lines import draw_map
from hybridworldsim.generation.network.configuration import CTSD_35, TINY, UNIMLVG, AdapterConfig
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
from hybridworldsim.generation.training.run import with_map
from hybridworldsim.generation.training.windows import ClipWindows, require_maps
from mirror.arrays import Float64
from mirror.errors import DatasetError, UsageError
from mirror.schema.road_map import LaneKind, MapArea, MapCrossing, MapLane, RoadMap
from tests.generation.builders import make_network
from tests.generation.clips import make_clip
from tests.generation.trained import CODEC, NETWORK, T

ACROSS = MapLine("lane", np.array([[14.0, 3.0, -1.0], [14.0, -3.0, -1.0]]))
WITH_MAP = replace(NETWORK, layout=AdapterConfig(7 * (T + 1), 8, scales=(1,)))


def clip_with(*lines: MapLine) -> Clip:
    return replace(make_clip(), lines=lines)


def test_the_file_of_a_clip_without_a_map_has_the_bytes_that_it_always_had(tmp_path: Path) -> None:
    """The arrays of a clip in the order of the first version, and nothing else."""
    clip = make_clip()
    write_clip(tmp_path, clip)
    names = ("clip_id", "drive_id", "rate_hz", "views", "images", "background", "present", "intrinsics")
    arrays = {name: np.asarray(getattr(clip, name)) for name in (*names, "ego_SE3_camera", "start_SE3_ego")}
    for name in ("frame", "track", "category", "ego_SE3_box", "lwh_m"):
        arrays[f"boxes_{name}"] = getattr(clip.boxes, name)
    sink = io.BytesIO()
    np.savez_compressed(sink, **arrays, tracks=clip.tracks)
    assert clip_path(tmp_path, clip.clip_id).read_bytes() == sink.getvalue()


@pytest.mark.parametrize(
    "lines", [(), (ACROSS, MapLine("crossing", np.arange(12.0).reshape(4, 3)), MapLine("drivable", ACROSS.points_m))]
)
def test_lines_are_read_as_they_were_written(tmp_path: Path, lines: tuple[MapLine, ...]) -> None:
    write_clip(tmp_path, clip_with(*lines))
    read = read_clip(tmp_path, "clip-0").lines
    assert read is not None and [line.kind for line in read] == [line.kind for line in lines]
    for one, other in zip(read, lines, strict=True):
        np.testing.assert_array_equal(one.points_m, other.points_m)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("lines_points_m", None, "cannot be read"),
        ("lines_count", np.array([3]), r"2 points for lines of 3"),
        ("lines_points_m", np.full((2, 3), np.nan), "line 0 of the map is not valid"),
        ("lines_kind", np.array(["river"]), "line 0 of the map is not valid"),
    ],
)
def test_broken_lines_of_a_file_are_named(tmp_path: Path, name: str, value: object, message: str) -> None:
    write_clip(tmp_path, clip_with(ACROSS))
    path = clip_path(tmp_path, "clip-0")
    with np.load(path) as file:
        arrays = dict(file) | {name: value}
    np.savez_compressed(path, **{key: array for key, array in arrays.items() if array is not None})
    with pytest.raises(DatasetError, match=message) as caught:
        read_clip(tmp_path, "clip-0")
    assert caught.value.file == str(path) and caught.value.remedy


@pytest.mark.parametrize(
    "points", [np.array([[0.0, 0.0, np.inf], [1.0, 0.0, 0.0]]), np.zeros((1, 3)), np.zeros((4, 2)), np.zeros(3)]
)
def test_a_line_that_is_not_valid_is_named(points: Float64) -> None:
    with pytest.raises(DatasetError, match="line 1 of the map is not valid") as caught:
        clip_with(ACROSS, MapLine("drivable", points))
    assert caught.value.place == "clip-0, a line of kind 'drivable'"


def green(first: int, end: int) -> Float64:
    """The image of a level line between two columns, half a pixel above and below the border of rows 9 and 10."""
    image = np.zeros((16, 24))
    image[9:11, first:end] = 0.5
    # Beside its ends, the distance of a pixel's centre is half a pixel along both axes.
    image[9:11, [first - 1, end]] = 1.0 - np.hypot(0.5, 0.5)
    return image


def test_a_line_is_drawn_where_the_camera_sees_it() -> None:
    """The line is 14 m before the clip's start and 1 m below the cameras; the vehicle drives 1 m a frame.

    In frame 4 it is 10 m away: with a focal length of 20 px and the middle at (12, 8), it lies at row 8 + 20 / 10, from
    column 12 - 20 * 3 / 10 to 12 + 20 * 3 / 10. The right camera is 1 m to the left: it sees it 2 px farther right.
    """
    layout = draw_frame_layout(clip_with(ACROSS), 4, OWN_STYLE, WITH_MAP)
    assert layout.shape == (2, 7, 16, 24)
    for view, shift in enumerate((0, 2)):
        expected = np.zeros((3, 16, 24))
        expected[1] = green(6 + shift, 18 + shift)
        np.testing.assert_allclose(layout[view, 4:], expected, atol=1e-6)
    # The next frames see it lower and lower; from frame 14 on it is behind the camera.
    rows = [draw_frame_layout(clip_with(ACROSS), frame, OWN_STYLE, WITH_MAP)[0, 5].sum(axis=1) for frame in (0, 4, 7)]
    assert [np.average(np.arange(16) + 0.5, weights=row) for row in rows] == pytest.approx([9.43, 10.0, 10.86], abs=0.1)


@pytest.mark.parametrize("points", [[[-9.0, 3.0, -1.0], [-2.0, -3.0, -1.0]], [[200.0, 3.0, -1.0], [90.0, -3.0, -1.0]]])
def test_lines_behind_the_camera_and_far_away_are_not_drawn(points: list[list[float]]) -> None:
    assert not draw_frame_layout(clip_with(MapLine("lane", np.array(points))), 0, OWN_STYLE, WITH_MAP)[:, 4:].any()


def test_a_clip_without_a_map_has_empty_channels_and_a_network_without_them_ignores_maps() -> None:
    with_map, empty, plain = clip_with(ACROSS), clip_with(), make_clip()
    boxes = draw_frame_layout(plain, 4, OWN_STYLE, NETWORK)
    np.testing.assert_array_equal(draw_frame_layout(with_map, 4, OWN_STYLE, NETWORK), boxes)
    for clip in (with_map, empty, plain):
        layout = draw_frame_layout(clip, 4, OWN_STYLE, WITH_MAP)
        np.testing.assert_array_equal(layout[:, :4], boxes)
        assert layout[:, 4:].any() == (clip is with_map)


def test_the_channels_of_a_layout_say_whether_a_network_takes_a_map() -> None:
    settings = GeneratorSettings()
    changed = with_map(settings)
    assert settings.network.layout is not None and changed.network.layout is not None
    assert (settings.network.layout.channels, changed.network.layout.channels) == (6 * 4, 6 * 7)
    assert not takes_map(TINY, OWN_STYLE) and takes_map(changed.network, OWN_STYLE)
    # References that are frames bring their layouts themselves; released weights were trained with maps.
    as_frames = GeneratorSettings(replace(TINY, reference_channels=0, layout=AdapterConfig(4, 8, scales=(1,))))
    network = with_map(as_frames).network
    assert network.layout == AdapterConfig(7, 8, scales=(1,)) and takes_map(network, OWN_STYLE)
    assert all(takes_map(config, OPENDWM_STYLE) for config in (CTSD_35, UNIMLVG))
    assert not takes_map(replace(TINY, layout=None), OWN_STYLE)
    with pytest.raises(UsageError, match="a network without layout"):
        with_map(replace(settings, network=replace(TINY, layout=None)))
    # A run without maps has the settings that it always had.
    names = {"reference_channels", "layout", "layout_frames", "map"}
    assert names & settings.document["network"].keys() == {"reference_channels", "layout"}
    assert {key for key in settings.document if settings.document[key] != changed.document[key]} == {"network"}


def test_training_says_how_many_clips_have_no_map() -> None:
    clips, folder = [clip_with(ACROSS), make_clip(), clip_with(), make_clip()], Path("clips")
    text = require_maps(headers_of(clips), WITH_MAP, OWN_STYLE, folder)
    assert text == "2 of 4 training clips have no map: no line is drawn in them"
    assert require_maps(headers_of(clips[::2]), WITH_MAP, OWN_STYLE, folder) is None
    assert require_maps(headers_of(clips), NETWORK, OWN_STYLE, folder) is None
    with pytest.raises(DatasetError, match="no training clip has a map"):
        require_maps(headers_of(clips[1::2]), WITH_MAP, OWN_STYLE, folder)


def test_windows_have_the_map_of_all_their_frames() -> None:
    windows = ClipWindows([clip_with(ACROSS)], TinyAutoencoder(CODEC), WITH_MAP, OWN_STYLE, T)
    layout = windows.batch([2]).conditions.layout
    assert layout is not None and layout.shape == (1, 1, 2, 7 * (T + 1), 16, 24)
    # The references are frames 2 and 3, the target frame 4, with the line half a pixel wide as above.
    np.testing.assert_allclose(layout[0, 0, 0, 7 * T + 5].numpy(), green(6, 18), atol=0.5 / 255.0 + 1e-6)
    rows = layout[0, 0, 0].unflatten(0, (T + 1, 7))[:, 5].sum(dim=2)
    middles = (rows * (torch.arange(16) + 0.5)).sum(dim=1) / rows.sum(dim=1)
    # 20 px * 1 m / depth below the middle of the image.
    np.testing.assert_allclose(middles, [8.0 + 20.0 / 12.0, 8.0 + 20.0 / 11.0, 8.0 + 20.0 / 10.0], atol=0.1)


def test_rollouts_see_the_map_of_seeds_and_of_generated_frames() -> None:
    network, codec = make_network(WITH_MAP).float(), TinyAutoencoder(CODEC)
    options = ClipRolloutOptions(SamplerSettings(steps=1))

    def roll(clip: Clip, edited: Clip | None = None) -> list[np.ndarray]:
        return [one.images for one in roll_out_clip(network, codec, clip, OWN_STYLE, 6, T, options, edited=edited)]

    # Before the vehicle in the seeds, behind it in the generated frames, which begin at 6 m.
    passed = MapLine("lane", np.array([[5.5, 3.0, -0.2], [5.5, -3.0, -0.2]]))
    clips = make_clip(), clip_with(), clip_with(passed), clip_with(ACROSS)
    plain, empty, seeds, both = map(roll, clips)
    assert all(np.array_equal(one, other) for one, other in zip(plain, empty, strict=True))
    assert not np.array_equal(plain[0], seeds[0]) and not np.array_equal(plain[1], both[1])
    # An edit holds from the first generated frame on: only the seeds, with their layouts, are those before it.
    edited = roll(make_clip(), clip_with(ACROSS))
    assert not any(np.array_equal(edited[0], one[0]) for one in (plain, both))


def test_cropped_lines_are_drawn_as_whole_ones() -> None:
    """A line that leaves the neighbourhood and comes back, seen from two places."""
    along = np.linspace(0.0, 4.0 * np.pi, 400)
    winding = np.column_stack([150.0 * np.sin(along), 20.0 * np.sin(0.7 * along) + along, np.full(400, -1.5)])
    far = MapLine("lane", winding + np.array([900.0, 0.0, 0.0]))
    lines = (MapLine("drivable", winding), far, MapLine("crossing", winding[:2] + np.array([5.0, 1.0, 0.0])))
    places = np.array([[0.0, 0.0, 0.0], [12.0, 1.0, 0.0]])
    cropped = crop_lines(lines, places)
    assert len(cropped) > 3 and sum(len(line.points_m) for line in cropped) < 300
    assert all(len(line.points_m) >= 2 for line in cropped)
    camera_SE3_ego = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    lens = np.array([[20.0, 0.0, 12.0], [0.0, 20.0, 8.0], [0.0, 0.0, 1.0]])
    for place in places:
        pose = np.eye(4)
        # The vehicle drives uphill.
        pose[:3, :3] = [[np.cos(0.1), 0.0, np.sin(0.1)], [0.0, 1.0, 0.0], [-np.sin(0.1), 0.0, np.cos(0.1)]]
        pose[:3, 3] = -pose[:3, :3] @ place
        drawn = [draw_map(some, pose, camera_SE3_ego, lens, (16, 24), 1.0) for some in (lines, cropped)]
        assert drawn[0].any()
        np.testing.assert_array_equal(*drawn)
    assert crop_lines(lines, places + 1e4) == () == crop_lines((), places)


def test_lines_of_a_road_map_follow_its_borders_on_the_ground() -> None:
    """A lane that climbs by a tenth and turns left, an area with a hole, a crossing, and lanes that are not drawn."""
    center = np.array([[0.0, 0.0, 5.0], [40.0, 0.0, 9.0]])

    def lane(name: str, kind: LaneKind, aside_m: float, width_m: float = 3.0) -> MapLane:
        return MapLane(name, kind, center + np.array([0.0, aside_m, 0.0]), np.full(2, width_m))

    lanes = [lane("a", "drive", 0.0), lane("b", "turn", 50.0), lane("c", "walk", 60.0), lane("d", "cycle", 2.5, 1.0)]
    outer = np.array([[0.0, -2.0], [40.0, -2.0], [40.0, 4.0], [0.0, 4.0]])
    hole = np.array([[10.0, 3.0], [12.0, 3.0], [12.0, 3.5]])
    zebra = np.array([[20.0, -2.0], [24.0, -2.0], [24.0, 4.0], [20.0, 4.0]])
    areas, crossings = (MapArea("road", (outer, hole)),), (MapCrossing("zebra", zebra),)
    road_map = RoadMap("s", None, False, {one.lane_id: one for one in lanes}, areas, crossings)
    lines = lines_of_map(road_map, np.full((1, 3), np.nan))
    kinds = [line.kind for line in lines]
    assert (kinds.count("drivable"), kinds.count("crossing"), kinds.count("lane"), len(kinds)) == (2, 1, 4, 7)
    sides = []
    for line in lines:
        steps = np.linalg.norm(np.diff(line.points_m[:, :2], axis=0), axis=1)
        assert steps.min() > 0.0 and steps.max() <= 2.0 + 1e-9
        if line.kind == "lane":
            x, y, z = line.points_m.T
            sides.append(float(y[0]))
            np.testing.assert_allclose(y, y[0], atol=1e-12)
            np.testing.assert_allclose((x[0], x[-1]), (0.0, 40.0), atol=1e-12)
            np.testing.assert_allclose(z, 5.0 + 0.1 * x, atol=1e-12)
        else:
            np.testing.assert_array_equal(line.points_m[0], line.points_m[-1])
            # Points of the middle line stand up to 2 m apart, so the nearest one is up to 0.1 m higher or lower.
            np.testing.assert_allclose(line.points_m[:, 2], 5.0 + 0.1 * line.points_m[:, 0], atol=0.101)
    assert sorted(sides) == pytest.approx([-1.5, 1.5, 2.0, 3.0])
    for ring, line in zip((outer, hole, zebra), lines):
        # The way along the line is that around the ring, and all corners are points of it.
        around = sum(np.hypot(*(end - begin)) for begin, end in itertools.pairwise([*ring, ring[0]]))
        assert np.linalg.norm(np.diff(line.points_m[:, :2], axis=0), axis=1).sum() == pytest.approx(around)
        assert all((np.abs(line.points_m[:, :2] - corner).max(axis=1) < 1e-9).any() for corner in ring)


def test_a_map_without_lanes_lies_at_the_height_of_the_driven_line() -> None:
    area = MapArea("road", (np.array([[0.0, -2.0], [40.0, -2.0], [40.0, 2.0], [0.0, 2.0]]),))
    driven = np.column_stack([np.linspace(0.0, 40.0, 81), np.zeros(81), np.linspace(5.0, 9.0, 81)])
    (line,) = lines_of_map(RoadMap("s", None, False, {}, (area,)), driven)
    np.testing.assert_allclose(line.points_m[:, 2], 5.0 + 0.1 * line.points_m[:, 0], atol=0.03)
    assert lines_of_map(RoadMap("s", None, False, {}, ()), driven) == ()


def test_lines_move_into_another_frame() -> None:
    pose = np.array([[0.0, -1.0, 0.0, 2.0], [1.0, 0.0, 0.0, 3.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]])
    (moved,) = move_lines((ACROSS,), pose)
    np.testing.assert_allclose(moved.points_m, [[-1.0, 17.0, 3.0], [5.0, 17.0, 3.0]])
    assert moved.kind == "lane"
