"""Where one flight went, without identifying anything (the manual's 6.5.1).

Needs  results/filtered/{quadrotor}/withGravity/{flight}.parquet and .json
Makes  results/trajectories/{quadrotor}/{flight}.png, the path with stills of the quadrotor, and {flight}.parquet, its rows;
       on demand {flight}.gif or {flight}.mp4, its animation
"""


rule trajectory:
    input:
        flight="results/filtered/{quadrotor}/withGravity/{flight}.parquet",
        metadata="results/filtered/{quadrotor}/withGravity/{flight}.json",
    output:
        table="results/trajectories/{quadrotor}/{flight}.parquet",
        figure="results/trajectories/{quadrotor}/{flight}.png",
    log:
        "logs/trajectories/{quadrotor}/{flight}.log",
    params:
        settings=lambda w: ask(
            FOLDER.model_jobs.flight_trajectory, w.quadrotor, w.flight
        ),
        code=code("trajectory.py"),
    script:
        "../scripts/trajectory.py"


rule trajectory_animation:
    input:
        flight="results/filtered/{quadrotor}/withGravity/{flight}.parquet",
        metadata="results/filtered/{quadrotor}/withGravity/{flight}.json",
    output:
        "results/trajectories/{quadrotor}/{flight}.{format}",
    log:
        "logs/trajectories/{quadrotor}/{flight}.{format}.log",
    wildcard_constraints:
        format="gif|mp4",
    params:
        settings=lambda w: ask(
            FOLDER.model_jobs.flight_trajectory, w.quadrotor, w.flight
        ),
        code=code("trajectory_animation.py"),
    script:
        "../scripts/trajectory_animation.py"
