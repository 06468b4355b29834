"""Names of the files in a run's folder."""

from enum import StrEnum


class RunFile(StrEnum):
    """All files that a run folder may hold; a folder with other files is never replaced."""

    RUN = "run.toml"
    MODEL = "model.xml"  # that was simulated
    BODY = "body.json"
    ENVIRONMENT = "environment.json"
    SUMMARY = "summary.json"
    SIGNALS = "signals.parquet"
    JOINTS = "joints.parquet"
    CONTACTS = "contacts.parquet"
    TICKS = "ticks.parquet"
    EXTERNAL = "external.parquet"
    RECORDING = "recording.rrd"
    REPORT = "report.html"
    EXPLANATION = "explain.json"
