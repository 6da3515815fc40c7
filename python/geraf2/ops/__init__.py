"""Kernels as functions of arrays and tensors; the only room that touches the native module."""
