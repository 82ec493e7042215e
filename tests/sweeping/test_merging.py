"""Shards become one table and arrays, by rows in order; what is missing, repeated or foreign is refused."""

import numpy as np
import pytest

import jaxfem as jf
from jaxfem import sweeping
from jaxfem.sweeping.merging import merge
from jaxfem.sweeping.shards import Manifest, shard_path, write_manifest, write_shard

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
