"""The service: poses in, draped garments out, over REST and WebSocket; ONNX Runtime inside, no torch."""
