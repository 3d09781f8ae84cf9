"""The objects of one node: `canopen info`, `read`, `write`, `backup`, `restore`, `compare`, `dump`, `check`, `flash`."""
