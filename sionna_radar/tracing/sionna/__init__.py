"""The scene inside Sionna RT, and the contract that a Sionna release must keep."""
