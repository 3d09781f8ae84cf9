"""CANopen as pure state machines: frames and time go in, frames and events come out. See docs/contract.md."""
