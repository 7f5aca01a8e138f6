"""The emulated MKS drive: state, behaviour and motor, in native frames, Modbus and CAN."""
