//! Estimator service: runs normal estimators on arm state and wrench.
