"""From a scan to a sewing pattern in one command: checks, recovery, report, retargeting, docs/recovery_run.md."""
