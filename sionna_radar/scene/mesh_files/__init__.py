"""Reading and repairing mesh files, one file per format.

The readers are our own: each checks what a header claims against the bytes that are there before memory is spent, reads
no texture, and follows no name out of the folder of the file given.
"""
