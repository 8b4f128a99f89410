"""Saved policies that are submissions without code: Stable-Baselines3, TorchScript, ONNX.

Each form has a function ``*_agent(submission, task)``. torch, Stable-Baselines3 and onnxruntime are imported when such an agent is made,
and never before.
"""
