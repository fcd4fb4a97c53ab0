"""Point-SLAM (Sandström et al., ICCV 2023): neural points, their decoders, rays rendered around the sensor's depth."""
