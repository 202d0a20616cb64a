"""How accurate will my set-up be? The same robot and motion on plates of different noise."""

import testbed as tb

for force_noise in (0.1, 0.5, 2.0):
    experiment = tb.Experiment.load(
        tb.shipped("table6"),
        [
            "motion.duration=10",
            "motion.candidates=3",
            f"measurement.force_noise={force_noise}",
            f"measurement.moment_noise={force_noise / 5}",
        ],
    )
    run = tb.carry_out(experiment)
    error = run.metrics["external_rms_relative_error"]
    times = run.metrics["internal_to_external"]
    print(
        f"{force_noise:.1f} N: plate's rms error {error:.2%}, the torques' {times:.0f} times that"
    )
