"""The whole chain for hours of simulated time: wires, processes, a crew, and what must hold."""
