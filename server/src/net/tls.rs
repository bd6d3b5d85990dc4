//! TLS, for servers that other machines reach: browsers give cameras, WebXR and WebCodecs only to pages loaded
//! over TLS. `ring` provides the cryptography, so that the build needs only a C compiler.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::{CryptoProvider, ring};
use tokio_rustls::rustls::pki_types::pem::{Error as PemError, PemObject};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{ClientConfig, Error as TlsError, RootCertStore, ServerConfig};

use crate::codec;

/// Largest certificate or key file, bytes.
const MAX_PEM_BYTES: u64 = 1 << 20;

/// Certificate and key of a server.
#[derive(Debug, Clone, Default, PartialEq, Eq, clap::Args)]
pub struct TlsFiles {
    /// Certificate chain (PEM), to serve over TLS: https and wss
    #[arg(long = "tls-cert", value_name = "FILE", requires = "key")]
    pub cert: Option<PathBuf>,
    /// Private key of the certificate (PEM)
    #[arg(long = "tls-key", value_name = "FILE", requires = "cert")]
    pub key: Option<PathBuf>,
}

impl TlsFiles {
    /// The TLS acceptor; `None` without certificate and key.
    pub(super) fn acceptor(&self) -> Result<Option<TlsAcceptor>> {
        let (Some(cert), Some(key)) = (&self.cert, &self.key) else {
            return Ok(None);
        };
        let chain = certificates(cert)?;
        let mut config = ServerConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()?
            .with_no_client_auth()
            .with_single_cert(chain, private_key(key)?)
            .map_err(|error| match error {
                TlsError::InconsistentKeys(_) => anyhow::anyhow!(
                    "{}: expected the key of the certificate in {}, got another",
                    key.display(),
                    cert.display()
                ),
                other => anyhow::anyhow!(
                    "{}: expected a certificate and its key, got: {other}",
                    cert.display()
                ),
            })?;
        // A WebSocket connection begins as HTTP/1.1.
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(Some(TlsAcceptor::from(Arc::new(config))))
    }
}

/// A client configuration that trusts servers whose certificate is signed by an authority in a file.
pub(super) fn trusting(ca: &Path) -> Result<ClientConfig> {
    let mut roots = RootCertStore::empty();
    for certificate in certificates(ca)? {
        roots
            .add(certificate)
            .with_context(|| format!("{}: expected certificates to trust", ca.display()))?;
    }
    Ok(ClientConfig::builder_with_provider(provider())
        .with_safe_default_protocol_versions()?
        .with_root_certificates(roots)
        .with_no_client_auth())
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>> {
    let pem = codec::read_file(path, MAX_PEM_BYTES)?;
    let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&pem).collect();
    match found {
        Ok(chain) if !chain.is_empty() => Ok(chain),
        Ok(_) => bail!("{}: expected a certificate (PEM), got none", path.display()),
        Err(error) => bail!(
            "{}: expected a certificate (PEM), got: {error}",
            path.display()
        ),
    }
}

fn private_key(path: &Path) -> Result<PrivateKeyDer<'static>> {
    let pem = codec::read_file(path, MAX_PEM_BYTES)?;
    PrivateKeyDer::from_pem_slice(&pem).map_err(|error| match error {
        PemError::NoItemsFound => {
            anyhow::anyhow!("{}: expected a private key (PEM), got none", path.display())
        }
        other => anyhow::anyhow!(
            "{}: expected a private key (PEM), got: {other}",
            path.display()
        ),
    })
}
