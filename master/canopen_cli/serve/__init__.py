"""Commands of `canopen serve`."""
