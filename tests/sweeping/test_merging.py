"""Shards become one table and arrays, by rows in order; what is missing, repeated or foreign is refused."""

import csv
import errno
from unittest.mock import Mock

import numpy as np
import pytest

import jaxfem as jf
from jaxfem import sweeping
from jaxfem.sweeping import merging, shards
from jaxfem.sweeping.merging import merge
from jaxfem.sweeping.shards import Manifest, read_shard, shard_path, write_manifest, write_shard

MANIFEST = Manifest("digest", 5, 2, "loop", "asked for")
YOUNG = {"young": np.arange(5.0)}


@pytest.fixture
def written(tmp_path):
    """Three shards of five variants: the folder, a large output (5, 4, 3, 3) and a small one (5,)."""
    rng = np.random.default_rng(0)
    path, end = rng.normal(size=(5, 4, 3, 3)), rng.normal(size=5)
    write_manifest(tmp_path, MANIFEST)
    for number, (a, b) in enumerate(((0, 2), (2, 4), (4, 5))):
        told = {name: np.zeros(b - a, int) for name in ("status", "iterations", "residual", "inverted")}
        told["status"][0] = number == 1
        write_shard(shard_path(tmp_path, number), MANIFEST, number, {"path": path[a:b], "end": end[a:b]}, told)
    return tmp_path, path, end


def test_csv_and_npy(written):
    folder, path, end = written
    made = merge(folder, MANIFEST, YOUNG)
    assert [each.name for each in made.files] == ["results.csv", "path.npy"]
    assert list(made.statuses.values()) == [4, 1] and any("iteration limit" in word for word in made.statuses)
    np.testing.assert_array_equal(np.load(made.files[1]), path)
    rows = (folder / "results.csv").read_text().splitlines()
    column = rows[0].split(",").index("end")
    assert [float(row.rsplit(",", 1)[1]) for row in rows[1:]] == end.tolist() and column == len(rows[0].split(",")) - 1
    assert "iteration limit" in rows[3]


def test_parquet_and_zarr(written):
    parquet, zarr = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("zarr")
    folder, path, end = written
    merge(folder, MANIFEST, YOUNG, "parquet", "zarr")
    table = parquet.read_table(folder / "results.parquet")
    assert table["variant"].to_pylist() == list(range(5)) and (table["end"].to_numpy() == end).all()
    assert (zarr.open(str(folder / "arrays" / "path.zarr"), mode="r")[:] == path).all()
    merge(folder, MANIFEST, YOUNG)  # and the other table says the same of each variant, in the same columns
    with (folder / "results.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == table.column_names
    for name in table.column_names:
        column = table[name].to_pylist()
        assert [type(each)(row[name]) for each, row in zip(column, rows, strict=True)] == column


@pytest.mark.parametrize("arrays", ["npy", "zarr"])
def test_a_merge_that_is_broken_off_leaves_what_was_there(written, monkeypatch, arrays):
    """Interrupted behind the first shard, or with a disk that is full: the last merge's files, and no others."""
    if arrays == "zarr":
        pytest.importorskip("zarr")
    folder = written[0]
    merge(folder, MANIFEST, YOUNG, arrays=arrays)
    before = {each: each.read_bytes() for each in folder.rglob("*") if each.is_file()}

    def interrupted(folder, manifest, number):
        if number == 2:
            raise KeyboardInterrupt
        return read_shard(folder, manifest, number)

    full = Mock(side_effect=OSError(errno.ENOSPC, "No space left on device"))
    place = (
        (merging, "read_shard", interrupted),
        (merging.os, "replace" if arrays == "zarr" else "posix_fallocate", full),
    )
    for broken, problem in zip(place, (KeyboardInterrupt, OSError), strict=True):
        with monkeypatch.context() as patch, pytest.raises(problem):
            patch.setattr(*broken)
            merge(folder, MANIFEST, {"young": np.arange(5.0) + 1}, arrays=arrays)
    assert {each: each.read_bytes() for each in folder.rglob("*") if each.is_file()} == before
    write_manifest(folder, MANIFEST)  # begun anew: nothing of the old sweep is left
    assert [each.name for each in folder.rglob("*") if each.is_file()] == ["manifest.json"]


def test_a_shard_on_a_full_disk_is_not_there(tmp_path, monkeypatch):
    write_manifest(tmp_path, MANIFEST)
    monkeypatch.setattr(shards.os, "fsync", Mock(side_effect=OSError(errno.ENOSPC, "No space left on device")))
    with pytest.raises(OSError, match="No space left"):
        write_shard(shard_path(tmp_path, 0), MANIFEST, 0, {"end": np.zeros(2)}, {"status": np.zeros(2, int)})
    assert not list((tmp_path / "shards").iterdir())


def test_shards_of_several_versions_are_told(written, monkeypatch):
    folder, path, end = written
    monkeypatch.setattr(shards, "made_by", lambda: {"jaxfem": "0.0"})
    told = {name: np.zeros(2, int) for name in ("status", "iterations", "residual", "inverted")}
    write_shard(shard_path(folder, 0), MANIFEST, 0, {"path": path[:2], "end": end[:2]}, told)
    assert merge(folder, MANIFEST, YOUNG).makers == 2


def test_what_is_wrong(written):
    folder, _, _ = written
    shard = shard_path(folder, 1)
    kept = shard.read_bytes()
    shard.unlink()
    with pytest.raises(jf.SweepError, match="1 of 3 shards are missing"):
        merge(folder, MANIFEST, YOUNG)
    shard.write_bytes(shard_path(folder, 0).read_bytes())
    with pytest.raises(jf.SweepError, match="shard 1 holds variants from 0 on, and others were due"):
        merge(folder, MANIFEST, YOUNG)
    shard.write_bytes(kept)
    with pytest.raises(jf.SweepError, match="of another sweep"):
        merge(folder, Manifest("other", 5, 2, "loop", "asked for"), YOUNG)
    assert sweeping.SweepError is jf.SweepError
