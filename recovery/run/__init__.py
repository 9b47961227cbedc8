"""From a scan to a sewing pattern in one command: checks, recovery, report, retargeting, docs/guide/recovery_run.md."""
