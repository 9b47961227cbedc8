"""What benchmarks share: options and records, the served network, physics optima, pictures."""
