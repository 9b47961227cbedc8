"""What a frame costs: latency and throughput, the wire, the differentiable simulator."""
