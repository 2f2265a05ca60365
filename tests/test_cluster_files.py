"""The files for SLURM and Kubernetes generate what the page of many rooms asks for (no cluster)."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "cluster"


def test_a_job_of_slurm_is_one_process_with_one_thread_that_ends_before_its_walltime() -> None:
    pytest.importorskip("dask_jobqueue")
    spec = importlib.util.spec_from_file_location("slurm", FOLDER / "slurm.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with module.cluster() as made:
        script = made.job_script()
    assert "#SBATCH --cpus-per-task=1" in script
    assert "#SBATCH --mem=4G" in script
    assert "NUMBA_NUM_THREADS=1" in script
    assert "MALLOC_TRIM_THRESHOLD_=268435456" in script
    assert "--nthreads 1 " in script
    assert "--nworkers" not in script or "--nworkers 1 " in script
    hours, minutes = re.findall(r"#SBATCH -t (\d+):(\d+):00", script)[0]
    life_h = float(re.findall(r"--lifetime (\d+)h", script)[0])
    stagger_min = float(re.findall(r"--lifetime-stagger (\d+)m", script)[0])
    assert 60 * life_h + stagger_min < 60 * int(hours) + int(minutes)


def test_the_pods_of_kubernetes_call_commands_with_options_that_exist() -> None:
    yaml = pytest.importorskip("yaml")
    scheduler = pytest.importorskip("distributed.cli.dask_scheduler")
    worker = pytest.importorskip("distributed.cli.dask_worker")
    parts = list(yaml.safe_load_all((FOLDER / "kubernetes.yaml").read_text()))
    service, *deployments = parts
    assert service["spec"]["ports"] == [{"port": 8786}]
    for deployment, command in zip(deployments, (scheduler, worker), strict=True):
        pod = deployment["spec"]["template"]
        assert pod["metadata"]["labels"] == deployment["spec"]["selector"]["matchLabels"]
        words = pod["spec"]["containers"][0]["command"]
        assert words[:2] == ["dask", deployment["metadata"]["name"].removeprefix("roomfit-")]
        known = {option for p in command.main.params for option in p.opts}
        assert {w for w in words if w.startswith("--")} <= known
    assert f"tcp://{service['metadata']['name']}:8786" in words
    threads = {e["name"]: e["value"] for e in pod["spec"]["containers"][0]["env"]}
    assert threads["NUMBA_NUM_THREADS"] == "1"
    assert threads["MALLOC_TRIM_THRESHOLD_"] == "268435456"
    assert words[words.index("--nthreads") + 1] == "1"
