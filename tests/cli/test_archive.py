"""`mocodec archive …`."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import pytest

import mocodec as mc
from mocodec.testing import synthetic

from .conftest import Command


@pytest.fixture
def vault(command: Command, tmp_path: Path) -> Path:
    for name, frames in (("07/walk_01", 40), ("07/walk_02", 60), ("08/run_01", 50)):
        path = tmp_path / f"raw/{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        mc.write(path, synthetic.joints(frames=frames, rate=60.0, seed=frames))
    built = command(
        "archive", "build", tmp_path / "raw", "-o", tmp_path / "vault", "--codec", "liu2006", "--max-error", "5mm"
    )
    assert built.code == 0, built.err
    assert "3 added; 3 recordings, 150 frames" in built.err
    return tmp_path / "vault"


def test_list_query_and_stats(command: Command, vault: Path) -> None:
    assert "08/run_01" in command("archive", "list", vault).out
    assert command("archive", "query", vault, "subject == 7", "--names").out.split() == ["07/walk_01", "07/walk_02"]
    row = json.loads(command("archive", "query", vault, "'run' in labels", "--json").out)
    assert (row["name"], row["frames"]) == ("08/run_01", 50)
    refused = command("archive", "query", vault, "open('x')")
    assert refused.code == 3
    assert len(refused.err.splitlines()) == 1
    stats = json.loads(command("archive", "stats", vault, "--json").out)
    assert (stats["recordings"], stats["failures"]) == (3, [])


def test_commands_take_a_recording_of_an_archive(command: Command, vault: Path, tmp_path: Path) -> None:
    one, raw = vault / "08" / "run_01", tmp_path / "raw/08/run_01.npz"
    facts = json.loads(command("info", one, "--json").out)
    assert (facts["codec"], facts["frames"]) == ("liu2006", 50)
    assert command("decode", one, "-o", tmp_path / "run.trc").code == 0
    assert command("convert", one, tmp_path / "run.npz").code == 0
    assert command("cut", one, "--from", "0.5s", "-o", tmp_path / "end.mocz").code == 0
    assert [len(mc.read(tmp_path / name)) for name in ("run.trc", "run.npz", "end.mocz")] == [50, 50, 20]
    assert command("verify", one, "--against", raw).code == 0
    assert "max error" in command("compare", raw, one).out
    for words in (("info",), ("decode", "-o", tmp_path / "x.trc"), ("verify",)):
        result = command(words[0], vault / "08" / "run_02", *words[1:])
        assert (result.code, "no recording named 08/run_02" in result.err) == (3, True), result.err


@pytest.mark.parametrize("name", ["info", "verify", "decode", "encode"])
def test_commands_on_files_refuse_a_whole_archive(command: Command, vault: Path, tmp_path: Path, name: str) -> None:
    output = ("-o", tmp_path / "out") if name in ("decode", "encode") else ()
    result = command(name, vault, *output)
    assert (result.code, f"{vault} is an archive: run `mocodec archive" in result.err) == (2, True), result.err


def test_append_remove_merge_extract(command: Command, vault: Path) -> None:
    mc.write(vault.parent / "jump.npz", synthetic.joints(frames=45, rate=60.0, seed=9))
    added = command("archive", "append", vault, vault.parent / "jump.npz", "-j", 2, "--json")
    assert json.loads(added.out)["added"] == ["jump"]
    assert command("archive", "remove", vault, "walk_01").code == 0
    assert command("archive", "merge", vault, "-o", vault.parent / "new").code == 0
    assert command("archive", "verify", vault.parent / "new", "--decode").out.endswith(
        "3 of 3 recordings are undamaged\n"
    )
    assert (
        command("archive", "extract", vault.parent / "new", "--query", "subject == 7", "-o", vault.parent / "out").code
        == 0
    )
    assert len(mc.decode(vault.parent / "out/07/walk_02.mocz")) == 60
    assert command("archive", "extract", vault, "jump", "-o", vault.parent / "out", "--format", "trc").code == 0
    assert (vault.parent / "out/jump.trc").exists()


def test_damage_and_wrong_use_are_one_line(command: Command, vault: Path) -> None:
    with mc.open_archive(vault) as db:
        place = db.entry("walk_02").place
    data = bytearray(Path(place.path).read_bytes())
    data[place.start + place.size // 2] ^= 4
    Path(place.path).write_bytes(data)
    found = command("archive", "verify", vault)
    assert found.code == 4
    assert found.out.startswith("07/walk_02: ")
    for arguments in (
        ("list", vault.parent / "raw"),
        ("append", vault.parent / "nowhere", vault.parent / "raw"),
        ("remove", vault),
        ("build", vault.parent / "nowhere", "-o", vault),
        ("build", vault.parent / "raw", "-o", vault, "--set", "colour=1"),
    ):
        result = command("archive", *arguments)
        assert result.code in (2, 3), arguments
        assert len(result.err.strip().splitlines()) == 1, result.err


def test_names_that_lead_out_of_the_folder(command: Command, tmp_path: Path) -> None:
    mc.write(tmp_path / "walk.npz", synthetic.joints(frames=40, seed=1))
    built = command(
        "archive", "build", tmp_path / "walk.npz", "-o", tmp_path / "vault", "--codec", "liu2006", "--prefix", "../../"
    )
    assert built.code == 0
    assert command("archive", "extract", tmp_path / "vault", "-o", tmp_path / "out").code == 3


def test_extract_lists_what_it_cannot_write(command: Command, vault: Path) -> None:
    out = vault.parent / "out"
    with mc.open_archive(vault) as db:
        place = db.entry("walk_01").place
    data = bytearray(Path(place.path).read_bytes())
    data[place.start + place.size // 2] ^= 4
    Path(place.path).write_bytes(data)
    for format_ in ("mocz", "trc"):
        result = command("archive", "extract", vault, "-o", out, "--format", format_)
        assert result.code == 4
        failed = [line for line in result.err.splitlines() if not line.startswith("note: ")]
        assert [line[:19] for line in failed] == ["failed: 07/walk_01:"]
        assert sorted(path.stem for path in out.rglob(f"*.{format_}")) == ["run_01", "walk_02"]
    unsuited = command("archive", "extract", vault, "walk_02", "run_01", "-o", out, "--format", "ply")
    assert unsuited.code == 3
    assert [line[:8] for line in unsuited.err.splitlines()] == ["failed: "] * 2
    for format_ in ("../../zz", "zz", "", "."):
        assert command("archive", "extract", vault, "-o", out, "--format", format_).code == 2


def test_a_line_break_in_a_name_makes_no_line(command: Command, vault: Path) -> None:
    with sqlite3.connect(vault / "catalogue.sqlite") as connection:
        connection.execute("UPDATE recordings SET name = ?, labels = ? WHERE stem = 'run_01'", ["a\nb", " c\nd "])
    connection.close()
    assert len(command("archive", "list", vault).out.splitlines()) == 4
    assert len(command("archive", "query", vault, "seconds > 0", "--names").out.splitlines()) == 3
    (vault / "shards/000001.mocs").write_bytes(b"")
    assert len(command("archive", "verify", vault).out.splitlines()) == 4
    assert len(command("archive", "extract", vault, "-o", vault / "out").err.splitlines()) == 3


def test_a_catalogue_with_a_changed_name_is_damaged(command: Command, vault: Path) -> None:
    """Its indices still have the name that was written."""
    path = vault / "catalogue.sqlite"
    path.write_bytes(path.read_bytes().replace(b"08/run_01", b"08/ran_01", 1))
    verified = command("archive", "verify", vault)
    assert verified.code == 4
    assert "the catalogue is damaged" in verified.err


def test_index_similar_and_duplicates(command: Command, vault: Path) -> None:
    mc.write(vault.parent / "long.npz", synthetic.joints(frames=240, rate=60.0, seed=9))
    (vault.parent / "same.npz").write_bytes((vault.parent / "long.npz").read_bytes())
    added = command("archive", "append", vault, vault.parent / "long.npz", vault.parent / "same.npz", "--index")
    assert added.code == 0, added.err
    assert "windows in the index" in command("archive", "index", vault).err
    found = json.loads(command("archive", "similar", vault, "long", "--from", 1, "--to", "3s", "--json").out)
    assert (found[0]["name"], round(found[0]["start"])) == ("same", 1)
    assert command("archive", "similar", vault, vault.parent / "long.npz", "-n", 1).out.split()[0] in ("long", "same")
    assert command("archive", "duplicates", vault).out == "long  same  equal\n"
    assert command("archive", "similar", vault, "07/walk_01").code == 3
