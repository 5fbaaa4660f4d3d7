"""Echo model: the mean echo of a beam from a surface, its speckle, and the likelihood of a measured echo."""
