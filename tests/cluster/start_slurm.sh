#!/usr/bin/env bash
# One-node SLURM for the tests: munge, controller and node as plain processes, everything they write below FOLDER.
#
#   tests/cluster/start_slurm.sh FOLDER [CPUS]     start; prints the line to source
#   tests/cluster/start_slurm.sh FOLDER stop       stop the three processes
#
# Needs root and Debian's packages slurmctld, slurmd, slurm-client and munge. No systemd, no cgroups, no accounting.
# The job's own srun finds its configuration at /etc/slurm/slurm.conf alone: the link there is removed by `stop`.
# Source: slurm.conf(5), munged(8).
set -euo pipefail
folder=$(mkdir -p "$1" && cd "$1" && pwd)
conf=/etc/slurm/slurm.conf

if [ "${2:-}" = stop ]; then
  for name in slurmd slurmctld munged; do
    if [ -f "$folder/$name.pid" ]; then kill "$(cat "$folder/$name.pid")" 2>/dev/null || true; fi
  done
  if [ "$(readlink "$conf" || true)" = "$folder/slurm.conf" ]; then rm -f "$conf"; fi
  exit 0
fi

for name in munged munge slurmctld slurmd sbatch sinfo; do
  command -v "$name" >/dev/null || PATH=$PATH:/usr/sbin command -v "$name" >/dev/null ||
    { echo "no $name: apt-get install --no-install-recommends slurmctld slurmd slurm-client munge" >&2; exit 3; }
done
[ "$(id -u)" = 0 ] || { echo "SLURM for tests is started by root alone" >&2; exit 3; }
[ ! -e "$conf" ] || { echo "$conf exists: this computer belongs to a cluster already" >&2; exit 3; }
PATH=$PATH:/usr/sbin

# munge refuses keys and sockets in folders that others may write
chmod 755 "$folder"
head -c 1024 /dev/urandom >"$folder/munge.key" && chmod 400 "$folder/munge.key"
munged --force --key-file="$folder/munge.key" --socket="$folder/munge.sock" --pid-file="$folder/munged.pid" \
  --seed-file="$folder/munge.seed" --log-file="$folder/munged.log"

host=$(hostname -s)
cat >"$folder/slurm.conf" <<CONF
ClusterName=quasi-tests
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge.sock
CredType=cred/munge
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
SlurmctldPort=16817
SlurmdPort=16818
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
MinJobAge=300
NodeName=$host NodeAddr=127.0.0.1 CPUs=${2:-$(getconf _NPROCESSORS_ONLN)} RealMemory=8000
PartitionName=main Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
mkdir -p "$folder/state" "$folder/spool" /etc/slurm
ln -s "$folder/slurm.conf" "$conf"
export SLURM_CONF="$folder/slurm.conf"
slurmctld -c
slurmd
for _ in $(seq 30); do
  if sinfo --noheader --format=%t 2>/dev/null | grep -q idle; then
    echo "export SLURM_CONF=$folder/slurm.conf"
    exit 0
  fi
  sleep 1
done
echo "the node did not become idle within 30 s; see $folder/slurmctld.log and slurmd.log" >&2
exit 4
