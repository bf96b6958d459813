"""The page in headless Chromium: it plays, seeks and shows the numbers that Python computes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import viewer
from mocodec.testing import hinged_figures, synthetic
from mocodec.viewer import facts, marks, page, session
from mocodec.viewer.recording import Shown, of_file
from mocodec.viewer.server import Server

WEB = Path(__file__).resolve().parents[2] / "web" / "viewer"
CHROMIUM = os.environ.get("MOCODEC_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium"),
    pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js"),
    pytest.mark.skipif(not (WEB / "node_modules").is_dir(), reason="needs `npm ci` in web/viewer (scripts/web)"),
    pytest.mark.xdist_group("chromium"),
]

LOADED = {"do": "wait", "for": "mocodecViewer.state().shownFrame >= 0"}
REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "cmu" / "c3d" / "85_12.c3d"
PLATES = REAL.parents[2] / "field-c3d" / "FP_Type1.c3d"
HOSTILE = "<img src=x onerror=\"document.title='broken'\">"


def drive(commands: list[dict[str, Any]], tmp_path: Path) -> list[Any]:
    """Run commands of web/viewer/test/browser.mjs; returns its answers. No error may appear in the page's console.

    Chromium hangs at times as it starts, so a run without an end is tried a second time.
    """
    (tmp_path / "commands.json").write_text(json.dumps(commands))
    made = run(tmp_path / "commands.json", 100) or run(tmp_path / "commands.json", 240)
    assert made is not None, "the browser hangs"
    assert made.returncode == 0, made.stderr
    result = json.loads(made.stdout)
    assert "failed" not in result, result
    assert result["problems"] == []
    answers: list[Any] = result["answers"]
    return answers


def run(script: Path, seconds: float) -> subprocess.CompletedProcess[str] | None:
    """Run a file of commands in the browser; None if it takes longer, and then no process of it is left."""
    command = ["node", str(WEB / "test" / "browser.mjs"), str(script)]
    environment = {**os.environ, "MOCODEC_CHROMIUM": str(CHROMIUM)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            output, errors = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            for number in (*descendants(process.pid), process.pid):
                with suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)
            return None
        return subprocess.CompletedProcess(command, process.returncode, output, errors)


def descendants(parent: int) -> list[int]:
    """The numbers of all processes below a process; none where there is no /proc."""
    children = list[int]()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            if int(fields[1]) == parent:
                children.append(int(stat.parent.name))
    return [number for child in children for number in (*descendants(child), child)]


def seek(frame: int) -> list[dict[str, Any]]:
    """Commands that show a frame and answer with the state of the page."""
    return [
        {"do": "eval", "code": f"mocodecViewer.seek({frame})"},
        {"do": "wait", "for": f"mocodecViewer.state().shownFrame === {frame}"},
        {"do": "eval", "code": "mocodecViewer.state()"},
    ]


@pytest.fixture
def server(original: mc.Motion, blob: bytes) -> Iterator[Server]:
    with ExitStack() as opened:
        pair = session.matched(
            of_file("walk.mocz", opened.enter_context(mc.open(blob, mc.Motion))), Shown("walk", original)
        )
        made = opened.enter_context(Server([pair], "walk"))
        thread = threading.Thread(target=made.serve_forever)
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def test_a_served_recording(server: Server, original: mc.Motion, blob: bytes, tmp_path: Path) -> None:
    decoded = mc.decode(blob, mc.Motion)
    numbers = "document.getElementById('numbers').innerText"
    play = [{"do": "press", "key": " "}, {"do": "wait", "for": "mocodecViewer.state().shownFrame !== 300"}]
    answers = drive(
        [
            {"do": "open", "url": server.url},
            LOADED,
            {"do": "eval", "code": numbers},
            *seek(300),
            *play,
            {"do": "press", "key": " "},
            {"do": "press", "key": "w"},
            {"do": "eval", "code": "mocodecViewer.state().frame"},
        ],
        tmp_path,
    )
    measured = mc.compare(original, decoded, len(blob))
    assert f"{1000 * measured.mean_error:.2f} mm" in answers[2]
    assert f"{1000 * measured.max_error:.2f} mm" in answers[2]
    assert "max 2 mm" in answers[2]
    state = answers[5]
    np.testing.assert_allclose(np.reshape(state["positions"], (6, 3)), decoded.positions[300], atol=1e-5)
    errors = np.linalg.norm(decoded.positions[300] - original.positions[300], axis=1)
    np.testing.assert_allclose(state["errors"], errors, atol=1e-6)
    assert measured.max_at is not None
    assert answers[-1] == measured.max_at[0]


def test_a_page_of_its_own_on_a_phone(original: mc.Motion, blob: bytes, tmp_path: Path) -> None:
    decoded = mc.decode(blob, mc.Motion)
    named = mc.Motion(decoded.positions, 60, (HOSTILE, *decoded.names[1:]))
    renamed = mc.Motion(original.positions, 60, (HOSTILE, *decoded.names[1:]))
    path = tmp_path / "page.html"
    viewer.save(path, viewer.html(named, against=renamed, title=HOSTILE))
    answers = drive(
        [
            {"do": "open", "url": path.as_uri(), "size": [390, 844], "theme": "dark"},
            LOADED,
            *seek(299),
            {"do": "click", "selector": "#points-button"},
            {"do": "eval", "code": "document.querySelectorAll('img').length"},
            {"do": "eval", "code": "document.getElementById('list').innerText"},
            {"do": "eval", "code": "document.documentElement.scrollWidth <= innerWidth"},
        ],
        tmp_path,
    )
    errors = np.linalg.norm(decoded.positions[299] - original.positions[299], axis=1)
    np.testing.assert_allclose(answers[4]["errors"], errors, atol=2e-5)
    assert answers[6] == 0
    assert HOSTILE in answers[7]
    assert answers[8]


def test_dropped_files_are_decoded_in_the_page(
    server: Server, original: mc.Motion, blob: bytes, tmp_path: Path
) -> None:
    (tmp_path / "walk.mocz").write_bytes(blob)
    (tmp_path / "exact.mocz").write_bytes(mc.encode(original, "lossless"))
    dropped = {"do": "drop", "files": [str(tmp_path / "walk.mocz"), str(tmp_path / "exact.mocz")]}
    answers = drive(
        [
            {"do": "open", "url": server.url.partition("?")[0]},
            dropped,
            LOADED,
            *seek(120),
            {"do": "eval", "code": "document.getElementById('numbers').innerText"},
        ],
        tmp_path,
    )
    decoded = mc.decode(blob, mc.Motion)
    got = np.reshape(np.array(answers[5]["positions"], float), (6, 3))
    np.testing.assert_allclose(got, decoded.positions[120], atol=1e-5)
    assert f"{1000 * mc.compare(original, decoded).max_error:.2f} mm" in answers[6]


def test_dropped_files_have_the_marks_that_python_finds(server: Server, original: mc.Motion, tmp_path: Path) -> None:
    commands: list[dict[str, Any]] = []
    wanted = list[str]()
    for codec in ("hou2014", "liu2006"):
        path = tmp_path / f"{codec}.mocz"
        path.write_bytes(mc.encode(original, codec, max_error=0.005))
        with mc.open(path, mc.Motion) as f:
            wanted.append(json.dumps(marks.marks(of_file(codec, f))))
        opened = {"do": "open", "url": server.url.partition("?")[0]}
        dropped = {"do": "drop", "files": [str(path)]}
        commands += [opened, dropped, LOADED, {"do": "eval", "code": "mocodecViewer.state().marks"}]
    assert [json.dumps(answer) for answer in drive(commands, tmp_path)[3::4]] == wanted


@pytest.mark.parametrize("name", ["bodycast-jumper-learned", "bodycast-jumper", "lien2006-jumper"])
def test_dropped_point_clouds_are_decoded_in_the_page(server: Server, name: str, tmp_path: Path) -> None:
    path = Path(__file__).parents[1] / "golden" / f"{name}.mocz"
    answers = drive(
        [
            {"do": "open", "url": server.url.partition("?")[0]},
            {"do": "drop", "files": [str(path)]},
            LOADED,
            *seek(2),
        ],
        tmp_path,
    )
    shown = np.array(answers[5]["positions"], float).reshape(-1, 3)
    wanted = mc.decode(path, mc.PointClouds).positions[2]
    assert len(shown)
    np.testing.assert_allclose(shown, wanted[: len(shown)], atol=1e-5)


def test_units_and_axes_of_point_clouds_can_be_chosen(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    clouds = mc.PointClouds([rng.normal(size=(50, 3)) for _ in range(3)], 15.0)
    viewer.save(tmp_path / "clouds.html", viewer.html(clouds))
    visible = "['#filter', '#list', '#up'].map((name) => document.querySelector(name).checkVisibility())"
    answers = drive(
        [
            {"do": "open", "url": (tmp_path / "clouds.html").as_uri()},
            LOADED,
            {"do": "eval", "code": visible},
            {"do": "click", "selector": "#points-button"},
            {"do": "eval", "code": visible},
            {"do": "choose", "selector": "#up", "value": "x"},
            {"do": "wait", "for": "mocodecViewer.state().up === 'x'"},
        ],
        tmp_path,
    )
    assert answers[2] == [False, False, False]
    assert answers[4] == [False, False, True]


def test_a_damaged_file_plays_the_rest(server: Server, original: mc.Motion, tmp_path: Path) -> None:
    data = bytearray(mc.encode(original, "lossless", chunk_seconds=2))
    with mc.open(bytes(data), mc.Motion) as f:
        chunk = f.encoded.chunks[2]
        start, stop, payload = chunk.start, chunk.stop, bytes(chunk.payload)
    data[data.index(payload) + len(payload) // 2] ^= 255
    (tmp_path / "damaged.mocz").write_bytes(data)
    dropped = {"do": "drop", "files": [str(tmp_path / "damaged.mocz")]}
    answers = drive(
        [{"do": "open", "url": server.url.partition("?")[0]}, dropped, LOADED, *seek(start + 5), *seek(stop + 5)],
        tmp_path,
    )
    assert all(value is None for value in answers[5]["positions"])
    got = np.reshape(np.array(answers[8]["positions"], float), (6, 3))
    np.testing.assert_allclose(got, original.positions[stop + 5], atol=1e-5)


def test_the_page_in_the_package_is_built_from_these_sources(tmp_path: Path) -> None:
    made = tmp_path / "viewer.html"
    subprocess.run(["node", "build.mjs", str(made)], cwd=WEB, check=True, capture_output=True, timeout=120)
    assert made.read_text() == page.viewer(), "run scripts/web, and commit the page"


def test_every_codec_is_decoded_in_the_page(server: Server, tmp_path: Path) -> None:
    markers = synthetic.markers(frames=120, seed=3)
    figure = hinged_figures.figure(60)
    made = {
        "tempo-max": (markers, mc.encode(markers, max_error=0.001)),
        "tempo-mean": (markers, mc.encode(markers, mean_error=0.003)),
        "hou2014": (markers, mc.encode(markers, "hou2014", max_error=0.005)),
        "liu2006": (markers, mc.encode(markers, "liu2006", max_error=0.005)),
        "lossless": (markers, mc.encode(markers, "lossless")),
        "rotations": (figure, mc.encode(figure, max_error=0.005)),
    }
    commands: list[dict[str, Any]] = []
    for name, (_, data) in made.items():
        (tmp_path / f"{name}.mocz").write_bytes(data)
        commands += [
            {"do": "open", "url": server.url.partition("?")[0]},
            {"do": "drop", "files": [str(tmp_path / f"{name}.mocz")]},
            LOADED,
            *seek(50),
        ]
    answers = drive(commands, tmp_path)[5::6]
    for state, (motion, data) in zip(answers, made.values(), strict=True):
        shown = np.array(state["positions"], float).reshape(-1, 3)[: motion.points]
        np.testing.assert_allclose(shown, mc.decode(data, mc.Motion).positions[50][: len(shown)], atol=1e-5)


@pytest.mark.skipif(not REAL.is_file(), reason="needs the recording 85_12 in ../shared/data")
@pytest.mark.parametrize("codec", ["tempo", "hou2014", "liu2006", "lossless"])
def test_a_real_recording_shows_its_errors(codec: str, tmp_path: Path) -> None:
    m = mc.read(REAL, mc.Motion)[1000:2200]
    data = mc.encode(m, codec) if codec == "lossless" else mc.encode(m, codec, max_error=0.005)
    decoded = mc.decode(data, mc.Motion)
    (tmp_path / "85_12.mocz").write_bytes(data)
    viewer.save(tmp_path / "85_12.html", viewer.html(tmp_path / "85_12.mocz", against=m))
    answers = drive(
        [
            {"do": "open", "url": (tmp_path / "85_12.html").as_uri()},
            LOADED,
            {"do": "click", "selector": "#worst"},
            {"do": "eval", "code": "mocodecViewer.state().frame"},
            *seek(600),
            {"do": "eval", "code": "document.getElementById('numbers').innerText"},
        ],
        tmp_path,
    )
    measured = mc.compare(m, decoded, len(data))
    assert measured.max_at is not None
    if codec != "lossless":
        assert answers[3] == measured.max_at[0]
        assert f"{1000 * measured.max_error:.2f} mm" in answers[7]
    shown = np.array(answers[6]["positions"], float).reshape(-1, 3)
    np.testing.assert_allclose(shown, decoded.positions[600][: len(shown)], atol=1e-3)


@pytest.mark.skipif(not PLATES.is_file(), reason="needs a recording of force plates in ../shared/data")
def test_a_dropped_file_of_a_lab_shows_its_forces(server: Server, tmp_path: Path) -> None:
    m = mc.read(PLATES, mc.Motion)
    data = mc.encode(m, max_error=0.002)
    (tmp_path / "lab.mocz").write_bytes(data)
    answers = drive(
        [
            {"do": "open", "url": server.url.partition("?")[0]},
            {"do": "drop", "files": [str(tmp_path / "lab.mocz")]},
            LOADED,
            *seek(len(m) // 2),
            {"do": "eval", "code": "JSON.stringify(mocodecViewer.view.facts.signals)"},
            {"do": "eval", "code": "document.getElementById('time').clientHeight"},
        ],
        tmp_path,
    )
    shown = np.array(answers[5]["positions"], float).reshape(-1, 3)
    np.testing.assert_allclose(shown, mc.decode(data, mc.Motion).positions[len(m) // 2][: len(shown)], atol=1e-5)
    strips, wanted = json.loads(answers[6]), facts.signals(m.extras)
    assert [strip["label"] for strip in strips] == [strip["label"] for strip in wanted]
    for strip, other in zip(strips, wanted, strict=True):
        assert min(strip["low"]) == pytest.approx(min(other["low"]), rel=1e-4)
        assert max(strip["high"]) == pytest.approx(max(other["high"]), rel=1e-4)
    assert answers[7] > 100  # three strips


def test_the_worst_error_is_named_on_the_first_screen(
    server: Server, original: mc.Motion, blob: bytes, tmp_path: Path
) -> None:
    answers = drive(
        [
            {"do": "open", "url": server.url},
            LOADED,
            {"do": "eval", "code": "document.getElementById('worst').innerText"},
            {"do": "click", "selector": "#worst"},
            {"do": "wait", "for": "mocodecViewer.state().shownFrame === mocodecViewer.state().frame"},
            {"do": "eval", "code": "[mocodecViewer.state().frame, document.getElementById('mark').textContent]"},
        ],
        tmp_path,
    )
    measured = mc.compare(original, mc.decode(blob, mc.Motion), len(blob))
    assert measured.max_at is not None
    frame, name = measured.max_at
    worst = f"{1000 * measured.max_error:.2f} mm"
    assert answers[2] == f"Largest error {worst}, {name} at {frame / original.rate:.2f} s"
    assert answers[5][0] == frame
    assert worst in answers[5][1]
    assert str(name) in answers[5][1]


def test_marks_that_turn_the_direction_of_text_are_shown(original: mc.Motion, tmp_path: Path) -> None:
    names = ("\u202eSILH", "LB\u2066", *original.names[2:])
    viewer.save(tmp_path / "page.html", viewer.html(mc.Motion(original.positions, 60, names), title="\u200fwalk"))
    answers = drive(
        [
            {"do": "open", "url": (tmp_path / "page.html").as_uri()},
            LOADED,
            {"do": "eval", "code": "document.body.innerText + document.title"},
        ],
        tmp_path,
    )
    assert "⟨202E⟩SILH" in answers[2]
    assert "LB⟨2066⟩" in answers[2]
    assert "⟨200F⟩walk" in answers[2]


def test_units_and_the_vertical_axis_are_chosen(server: Server, tmp_path: Path) -> None:
    choose = (
        "(() => { const s = document.getElementById('%s'); s.value = '%s'; s.dispatchEvent(new Event('change')); })()"
    )
    answers = drive(
        [
            {"do": "open", "url": server.url},
            LOADED,
            {"do": "eval", "code": choose % ("unit", "in")},
            {"do": "eval", "code": "document.getElementById('worst').innerText"},
            {"do": "eval", "code": choose % ("up", "z")},
            {"do": "eval", "code": "mocodecViewer.view.facts.up"},
        ],
        tmp_path,
    )
    assert " in, " in answers[3]
    assert answers[5] == "z"


def test_point_clouds_and_force_plates(original: mc.Motion, clouds: mc.PointClouds, tmp_path: Path) -> None:
    (tmp_path / "clouds.html").write_text(viewer.html(clouds, against=clouds))
    (tmp_path / "lab.html").write_text(viewer.html(original))
    answers = drive(
        [
            {"do": "open", "url": (tmp_path / "clouds.html").as_uri()},
            LOADED,
            *seek(2),
            {"do": "open", "url": (tmp_path / "lab.html").as_uri()},
            LOADED,
            {"do": "eval", "code": "document.getElementById('channels').textContent"},
            {"do": "eval", "code": "document.getElementById('time').clientHeight"},
        ],
        tmp_path,
    )
    assert answers[4]["shownFrame"] == 2
    assert len(answers[4]["positions"]) == 3 * 70
    assert "Fz1 (N)" in answers[7]
    assert answers[8] > 40  # a strip for the force
