"""The shared core: garments as polynomial patches, bodies, motions, cloth energies and the wire.

Imports no torch, and onnxruntime only where a model needs it; formulas take numpy or torch arrays.
"""
