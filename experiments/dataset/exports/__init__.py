"""Files for whoever gets a dataset: data card, contact sheet, index, COCO, WebDataset."""
