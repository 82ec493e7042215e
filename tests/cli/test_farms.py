"""The worker of a sweep under other people's engines, each by its local backend, where it is installed."""

import concurrent.futures
import importlib.util

import pytest
from test_sweep import SCENE, SWEEP

from jaxfem.cli import farms
from jaxfem.cli.main import main

pytestmark = pytest.mark.slow
JOBS = 2


def needs(module):
    """Skips a test, before its sweep is begun, where a module is not installed."""
    return pytest.mark.skipif(importlib.util.find_spec(module) is None, reason=f"needs {module}: pip install it")


@pytest.fixture
def begun(tmp_path):
    """A sweep of three shards, begun; what ran it is asked for at the end."""
    (tmp_path / "scene.toml").write_text(SCENE)
    path = tmp_path / "sweep.toml"
    path.write_text(SWEEP.replace("count = 75", "count = 5"))
    manifest = farms.begin(path)
    assert manifest.shards == 3 == farms.left(path, None, manifest)
    yield str(path)
    assert farms.left(path, None, manifest) == 0
    assert main(["sweep", str(path)]) == 0
    assert len((tmp_path / "sweep_results" / "results.csv").read_text().splitlines()) == 6


def test_an_executor(begun, tmp_path):
    with concurrent.futures.ThreadPoolExecutor(JOBS) as executor:
        with pytest.raises(RuntimeError, match="no scene file"):
            farms.with_executor(executor, str(tmp_path / "none.toml"), 1)
        farms.with_executor(executor, begun, JOBS)


@needs("submitit")
def test_submitit(begun, tmp_path):
    import submitit

    executor = submitit.LocalExecutor(folder=tmp_path / "jobs")
    executor.update_parameters(timeout_min=5)
    farms.with_submitit(executor, begun, JOBS)


@needs("distributed")
def test_dask(begun):
    import distributed

    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=JOBS, processes=False, dashboard_address=None) as made,
        distributed.Client(made) as client,
    ):
        farms.with_dask(client, begun, JOBS)


@needs("ray")
def test_ray(begun):
    import ray

    ray.init(num_cpus=JOBS, include_dashboard=False)
    try:
        farms.with_ray(ray, begun, JOBS)
    finally:
        ray.shutdown()
