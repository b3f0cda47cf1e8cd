//! The files of an enclave in a keystore of `ros2 security`.
