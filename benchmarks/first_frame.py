"""A process that makes one fused frame of eight IMUs and ends; `startup.py` times it."""

from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.simulation.placements import ring

pipeline = Pipeline(ring(8), PipelineConfig())
for scan in range(3):
    for imu in range(8):
        pipeline.push(imu, scan * 5_000_000, [0.001 * scan, 0.0, 0.0, 0.0, 0.0, 9.81])
