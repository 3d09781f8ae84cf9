"""Process data: the bits of a PDO (`mapping`), receiving and sending one (`consumer`, `producer`), a device's own PDOs
(`parameters`, by the `rules`), and multiplexed PDOs (`multiplexed`).

The PDOs of another node: `settings` says what one carries and when it is sent, `slots` reads and chooses them from the node's
file, `configure` has the procedures that bring the node to them and exchange them."""
