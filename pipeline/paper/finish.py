from pipeline.sweep.finish import finish
