#!/bin/bash
# geraf2 batch on machines by SSH: a scheduler here, workers there, then the batch.
#
#     HOSTS="a b c" examples/batch_ssh.sh scans.csv OUT [flags of geraf2 batch]
#
# All machines see scenes and OUT under the same paths (or they are addresses of an object store),
# and have the same geraf2 on their PATH. Keep the port closed to others.
set -eu
host=${SCHEDULER_HOST:-$(hostname)}
port=${SCHEDULER_PORT:-8786}
address=tcp://$host:$port
dask scheduler --host "$host" --port "$port" --no-dashboard &
trap 'kill $(jobs -p) 2>/dev/null || true; wait' EXIT # the workers end when their scheduler is gone
for one in $HOSTS; do
    ssh "$one" dask worker "$address" --nworkers "${WORKERS:-8}" --nthreads 1 \
        --memory-limit 0 --resources MEMORY=4e9 --death-timeout 60 --no-dashboard &
done
geraf2 batch "$@" --scheduler "$address"
