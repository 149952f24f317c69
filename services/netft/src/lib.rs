//! ATI Net F/T sensor service: RDT records in, conditioned wrench out.
