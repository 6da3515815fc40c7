"""Many scans on all cores, a line for each as it is done.

python examples/batch.py OUT 0.22 0.22 0.22 scans/*
"""

import sys

from geraf2.apps.batch import read_jobs, run

if __name__ == "__main__":  # the workers read this file, too
    out, box, scans = sys.argv[1], tuple(map(float, sys.argv[2:5])), sys.argv[5:]
    results = run(read_jobs(scans, box=box), out, on_result=lambda result: print(result.line))
    done = sum(result.state == "done" for result in results)
    print(f"{done} of {len(results)} done, {out}/batch.html")
