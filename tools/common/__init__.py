"""What several commands share: options, the attachment to a bus, tables of results, recordings."""
