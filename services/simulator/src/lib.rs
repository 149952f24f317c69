//! A robot cell on sockets: UR controller and Net F/T box around the simulated plant.
