"""The files for SLURM and Kubernetes generate what the page of many rooms asks for (no cluster)."""

from __future__ import annotations

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "cluster"


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
