"""Workers as SLURM jobs; then: roomfit batch ... --scheduler ADDRESS, which this prints.

pip install 'roomfit[cluster]' dask-jobqueue
python slurm.py 20
"""

import sys
import time

from dask_jobqueue import SLURMCluster


def cluster() -> SLURMCluster:
    """Return a cluster without jobs: one process and one thread a job, for three hours."""
    return SLURMCluster(
        cores=1,
        processes=1,
        memory="4GB",
        walltime="03:30:00",
        job_script_prologue=[
            "export NUMBA_NUM_THREADS=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1",
            # arrays are not given back to the system one by one (dask's own value is 64 kB)
            "export MALLOC_TRIM_THRESHOLD_=268435456 MALLOC_MMAP_THRESHOLD_=33554432",
        ],
        # before the walltime, and not all at the same time
        worker_extra_args=["--lifetime", "3h", "--lifetime-stagger", "10m"],
        # put the name of the cluster's inner network in place of the loopback
        scheduler_options={"host": "127.0.0.1", "dashboard_address": "127.0.0.1:8787"},
    )


if __name__ == "__main__":
    with cluster() as started:
        started.scale(jobs=int(sys.argv[1]))
        print(started.scheduler_address, flush=True)
        while True:
            time.sleep(60)
