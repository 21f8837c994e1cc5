"""DS: the dataset's documents, folders and ids."""
