"""Set-up of the ray tracer: libLLVM, the Dr.Jit variant, and the report on them for `doctor`."""
