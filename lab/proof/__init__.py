"""Proof on real machines: pages whose every figure is computed by the command that writes them."""
