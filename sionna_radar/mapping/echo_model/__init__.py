"""The echo that a beam returns from a surface: its mean, its speckle, and the likelihood of a measured one."""
