"""The shared core: garments as polynomial patches, bodies, motions, cloth energies and the wire.

Imports neither torch nor onnxruntime; formulas take numpy or torch arrays.
"""

__version__ = "0.1.0"
