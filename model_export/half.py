"""The packed graph with the network's matrices in 16 bits, for GPUs, whose tensor cores multiply those.

Only products with the network's own weights, their inputs and outputs: places, frames, charts and contact are in metres
at a tenth of a millimetre, which float16 does not hold. The file keeps no second copy of the weights: a cast to 16 bits
follows each, which ONNX Runtime does once, when it opens the graph.
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper

from drape.errors import ArtifactError

HALF = "packed_half"  # its name in a model folder
LEAST = 64 * 64  # numbers of a matrix: smaller ones gain less than the casts cost
# Inputs of the decoder's second layer cancel: alone in 16 bits it moves vertices by 1.2 mm, the other sixteen by 0.02.
WHOLE = ("trunk.0.weight",)
LARGEST_ERROR_M = 5e-4  # between vertices of both graphs: above, a model keeps 32 bits


def halve_matrices(proto: onnx.ModelProto, *, least: int = LEAST) -> int:
    """Casts the inputs of Gemms with weights of at least ``least`` numbers to float16, and their outputs back.

    Weights of ``WHOLE`` stay as they are. Returns the number of Gemms; refuses (``ArtifactError``) a graph with none.
    """
    graph = proto.graph
    sizes = {
        tensor.name: int(np.prod(tensor.dims)) for tensor in graph.initializer if tensor.data_type == TensorProto.FLOAT
    }
    nodes, cast, count = [], {}, 0
    for node in graph.node:
        if node.op_type != "Gemm" or sizes.get(node.input[1], 0) < least or node.input[1] in WHOLE:
            nodes.append(node)
            continue
        count += 1
        for place, name in enumerate(node.input):
            if name not in cast:
                cast[name] = f"{name}_half"
                nodes.append(helper.make_node("Cast", [name], [cast[name]], to=TensorProto.FLOAT16))
            node.input[place] = cast[name]
        whole = node.output[0]
        node.output[0] = f"{whole}_product"
        nodes += [node, helper.make_node("Cast", [node.output[0]], [whole], to=TensorProto.FLOAT)]
    if count == 0:
        raise ArtifactError(
            "packed graph", expected=f"a Gemm with {least} weights or more", got="none", cure="Export the model again."
        )
    del graph.node[:]
    graph.node.extend(nodes)
    return count
