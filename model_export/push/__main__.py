"""Traces the graphs of the push-out anew and stores them: after a change of what they compute.

python -m model_export.push
"""

from __future__ import annotations

from model_export.push.push_graphs import PUSHES, graph_path, trace_graph

if __name__ == "__main__":
    for name in PUSHES:
        graph_path(name).write_bytes(trace_graph(name))
