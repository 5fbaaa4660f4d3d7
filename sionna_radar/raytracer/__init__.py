"""The ray tracer's set-up: libLLVM, the Dr.Jit variant, and what `doctor` reports of them."""
