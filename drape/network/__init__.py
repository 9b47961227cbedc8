"""The packed graph's network on a processor, compiled: patches in rows of sixteen."""
