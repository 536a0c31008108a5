"""States, biases, forces and moments of one flight.

Needs  results/imported/{quadrotor}/{flight}.parquet and .json
Makes  results/filtered/{quadrotor}/withGravity/{flight}.parquet and .json, noGravity/ alike,
       and the filter over time, results/filtered/{quadrotor}/convergence/{flight}.parquet
"""


rule filtering:
    input:
        flight="results/imported/{quadrotor}/{flight}.parquet",
        metadata="results/imported/{quadrotor}/{flight}.json",
    output:
        with_gravity="results/filtered/{quadrotor}/withGravity/{flight}.parquet",
        with_gravity_metadata="results/filtered/{quadrotor}/withGravity/{flight}.json",
        no_gravity="results/filtered/{quadrotor}/noGravity/{flight}.parquet",
        no_gravity_metadata="results/filtered/{quadrotor}/noGravity/{flight}.json",
        convergence="results/filtered/{quadrotor}/convergence/{flight}.parquet",
    log:
        "logs/filtering/{quadrotor}/{flight}.log",
    benchmark:
        "results/benchmarks/filtering/{quadrotor}/{flight}.tsv"
    resources:
        flights=1,
    params:
        settings=lambda wildcards: ask(
            FOLDER.recordings.filtering, wildcards.quadrotor, wildcards.flight
        ),
        code=code("filtering.py"),
    script:
        "../scripts/filtering.py"
