"""The push-out as graphs of their own."""
